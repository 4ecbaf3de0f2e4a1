// The images of glTF to texels as they are stored: no colour management, no premultiplication, no turning.

import { nodeModule } from './core.js';
import { MipbakeError } from './errors.js';

/** @typedef {import('./maps.js').StoredMap} StoredMap */

/**
 * The texels of a PNG, JPEG or WebP file.
 * @param {Uint8Array} bytes
 * @param {string} mimeType
 * @param {string} name for messages
 * @param {any} encoder the function of the package sharp; undefined: sharp where it is installed, else the browser
 * @returns {Promise<StoredMap>}
 */
export async function decodedImage(bytes, mimeType, name, encoder) {
    if (!['image/png', 'image/jpeg', 'image/webp'].includes(mimeType)) {
        throw new MipbakeError(
            `the texture ${name} is ${mimeType}: expected PNG, JPEG or WebP, before it is compressed`,
        );
    }
    const sharp = encoder ?? (nodeModule('node:fs') ? await installedSharp() : undefined);
    try {
        return await (sharp ? bySharp(sharp, bytes) : byBrowser(bytes, mimeType));
    } catch (error) {
        const reason = String(error instanceof Error ? error.message : error).split('\n')[0];
        throw new MipbakeError(`the texture ${name} cannot be decoded (${reason}): export it again`);
    }
}

async function installedSharp() {
    try {
        const name = 'sharp'; // a name in a variable keeps bundlers from looking for it
        return (await import(/* webpackIgnore: true */ /* @vite-ignore */ name)).default;
    } catch {
        throw new MipbakeError('images are decoded by the package sharp, which is missing here: run npm install sharp');
    }
}

/**
 * @param {any} sharp
 * @param {Uint8Array} bytes
 * @returns {Promise<StoredMap>}
 */
async function bySharp(sharp, bytes) {
    const image = sharp(bytes, { ignoreIcc: true, limitInputPixels: false });
    const { depth, channels: count } = await image.metadata();
    const deep = depth === 'ushort';
    const raw = (deep ? image.toColourspace(count < 3 ? 'grey16' : 'rgb16') : image).raw({
        depth: deep ? 'ushort' : 'uchar',
    });
    const { data, info } = await raw.toBuffer({ resolveWithObject: true });
    const own = data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
    const { width, height, channels } = info;
    return { data: deep ? new Uint16Array(own) : new Uint8Array(own), width, height, channels };
}

/**
 * A canvas of two dimensions would multiply colours by alpha; WebGL gives back what it was given.
 * @param {Uint8Array} bytes
 * @param {string} type
 * @returns {Promise<StoredMap>}
 */
async function byBrowser(bytes, type) {
    const blob = new Blob([/** @type {any} */ (bytes)], { type });
    const image = await createImageBitmap(blob, { colorSpaceConversion: 'none', premultiplyAlpha: 'none' });
    const { width, height } = image;
    const gl = new OffscreenCanvas(1, 1).getContext('webgl2');
    if (!gl) throw new Error('this browser has no WebGL 2');
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
    gl.framebufferTexture2D(
        gl.FRAMEBUFFER,
        gl.COLOR_ATTACHMENT0,
        gl.TEXTURE_2D,
        gl.getParameter(gl.TEXTURE_BINDING_2D),
        0,
    );
    const data = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, data);
    const failed = gl.getError();
    gl.getExtension('WEBGL_lose_context')?.loseContext();
    if (failed) throw new Error(`an image of ${width} x ${height} is too large here`);
    return { data, width, height, channels: 4 };
}
