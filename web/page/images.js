// Images to texels and back. A canvas of two dimensions would multiply colours by alpha and lose what is transparent, so
// WebGL reads them, and PNG files are written here.
import { crc32 } from './zip.js';

/** @typedef {{data: Uint8Array, width: number, height: number, channels: number}} Texels */

const DECODED = /\.(png|jpe?g|webp|avif|bmp|gif)$/i;
const NOT_DECODED = /\.(exr|tiff?|tga|hdr|psd|dds|ktx2?)$/i;

export const isImage = (name) => DECODED.test(name);
export const isOtherImage = (name) => NOT_DECODED.test(name);

let graphics = null;

/** Texels as the file stores them, 8 bits each: colours are not converted. @param {Blob} blob @returns {Promise<Texels>} */
export async function decoded(blob, name) {
    let bitmap;
    try {
        bitmap = await createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
    } catch {
        throw new Error(`${name} cannot be read as an image: open it in an image editor, and save it as PNG.`);
    }
    const { width, height } = bitmap;
    graphics ??= document.createElement('canvas').getContext('webgl2');
    if (!graphics) throw new Error('This browser shows no WebGL 2: open the page in another one, or allow hardware acceleration.');
    const gl = graphics, most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(width, height) > most) throw new Error(`${name} is ${width} × ${height}, and this device shows ${most} texels a side at most: make the images smaller.`);
    const texture = gl.createTexture(), target = gl.createFramebuffer(), data = new Uint8Array(4 * width * height);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const [option, value] of [[gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false], [gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE]]) gl.pixelStorei(option, value);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, data);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(texture);
    bitmap.close();
    return { data, width, height, channels: 4 };
}

/** Some channels of an image, by letters. @param {Texels} image @param {string} letters @returns {Texels} */
export function channelsOf(image, letters, inverted = false) {
    const places = [...letters].map((letter) => 'RGBA'.indexOf(letter)), count = image.width * image.height;
    const data = new Uint8Array(count * places.length);
    for (let texel = 0, write = 0; texel < count; ++texel) {
        for (const place of places) {
            const value = image.data[image.channels * texel + place];
            data[write++] = inverted ? 255 - value : value;
        }
    }
    return { data, width: image.width, height: image.height, channels: places.length };
}

/** The least value of a channel. */
export function least(image, channel) {
    let found = 255;
    for (let i = channel; i < image.data.length; i += image.channels) found = Math.min(found, image.data[i]);
    return found;
}


/**
 * "opengl" or "directx", by the curl of the slopes; "" where it does not tell. mipbake/source/normal.py has the reasons.
 * @param {Texels} image
 */
export function conventionOf({ data, width, height, channels }) {
    const slope = (x, y, axis) => {
        const i = channels * (y * width + x), z = Math.max((2 * data[i + 2]) / 255 - 1, 0.2);
        return ((2 * data[i + axis]) / 255 - 1) / z;
    };
    const tiles = [], step = Math.max(1, Math.floor(Math.min(width, height) / 256)), side = Math.ceil(Math.min(width, height) / 8);
    let energy = 0;
    for (let top = 1; top < height - 1; top += side) {
        for (let left = 1; left < width - 1; left += side) {
            let products = 0;
            for (let y = top; y < Math.min(top + side, height - 1); y += step) {
                for (let x = left; x < Math.min(left + side, width - 1); x += step) {
                    let dp = 0, dq = 0;
                    for (const [offset, weight] of [[-1, 1], [0, 2], [1, 1]]) {
                        dp += weight * (slope(x + offset, y - 1, 0) - slope(x + offset, y + 1, 0));
                        dq += weight * (slope(x + 1, y + offset, 1) - slope(x - 1, y + offset, 1));
                    }
                    products += dp * dq;
                    energy += (dp * dp + dq * dq) / 2;
                }
            }
            tiles.push(products);
        }
    }
    const total = tiles.reduce((sum, x) => sum + x, 0), spread = Math.sqrt(tiles.reduce((sum, x) => sum + x * x, 0));
    if (energy <= 1e-12 || !spread) return '';
    // Tiles have to agree by 1.2 standard deviations, and by more than compression does.
    const effect = total / energy, decided = Math.abs(total / spread) > 1.2 && Math.abs(effect) > 0.08;
    return decided ? (effect > 0 ? 'opengl' : 'directx') : '';
}

const SIGNATURE = [137, 80, 78, 71, 13, 10, 26, 10];
const COLOUR_TYPES = { 1: 0, 2: 4, 3: 2, 4: 6 };

/** The bytes of a PNG file. @param {Texels} image @returns {Promise<Uint8Array>} */
export async function png({ data, width, height, channels }) {
    const row = width * channels, lines = new Uint8Array((row + 1) * height);
    for (let y = 0; y < height; ++y) {
        const start = y * row, write = y * (row + 1) + 1;
        lines[write - 1] = y ? 4 : 1;  // Paeth's filter; in the first row it is the difference from the left
        for (let i = 0; i < row; ++i) {
            const left = i >= channels ? data[start + i - channels] : 0, up = y ? data[start + i - row] : 0;
            const both = y && i >= channels ? data[start + i - row - channels] : 0;
            const [dl, du, db] = [Math.abs(up - both), Math.abs(left - both), Math.abs(left + up - 2 * both)];
            lines[write + i] = data[start + i] - (dl <= du && dl <= db ? left : du <= db ? up : both);
        }
    }
    const packed = new Blob([lines]).stream().pipeThrough(new CompressionStream('deflate'));
    const head = new DataView(new ArrayBuffer(13));
    head.setUint32(0, width);
    head.setUint32(4, height);
    head.setUint8(8, 8);
    head.setUint8(9, COLOUR_TYPES[channels]);
    const parts = [
        new Uint8Array(SIGNATURE), chunk('IHDR', new Uint8Array(head.buffer)),
        chunk('IDAT', new Uint8Array(await new Response(packed).arrayBuffer())), chunk('IEND', new Uint8Array(0)),
    ];
    return new Uint8Array(await new Blob(parts).arrayBuffer());
}

function chunk(kind, content) {
    const whole = new Uint8Array(12 + content.length), view = new DataView(whole.buffer);
    view.setUint32(0, content.length);
    whole.set(new TextEncoder().encode(kind), 4);
    whole.set(content, 8);
    view.setUint32(8 + content.length, crc32(whole.subarray(4, 8 + content.length)));
    return whole;
}

/** Values times a factor of the material; of normals, of what lies across the surface. @param {Texels} image */
export function withFactor(role, image, factor) {
    if (factor === 1 || role === 'base_color' || role === 'anisotropy') return image;
    if (role !== 'normal') return { ...image, data: image.data.map((value) => Math.round(value * factor)) };
    const data = new Uint8Array(image.data.length), { channels } = image;
    for (let i = 0; i < data.length; i += channels) {
        const n = [0, 1, 2].map((c) => (image.data[i + c] / 127.5 - 1) * (c < 2 ? factor : 1)), length = Math.hypot(...n) || 1;
        for (let c = 0; c < 3; ++c) data[i + c] = Math.round(127.5 + (127.5 * n[c]) / length);
    }
    return { ...image, data };
}
