// WebGL2: uploads the levels as they were made, draws every side into float targets, and composes the screen from them.

function perspective(fieldOfView, aspect, near, far) {  // column-major, as WebGL reads it
    const f = 1 / Math.tan(fieldOfView / 2);
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) / (near - far), -1, 0, 0, 2 * near * far / (near - far), 0];
}

function product(a, b) {
    const out = new Array(16).fill(0);
    for (let column = 0; column < 4; ++column) {
        for (let row = 0; row < 4; ++row) {
            for (let k = 0; k < 4; ++k) out[4 * column + row] += a[4 * k + row] * b[4 * column + k];
        }
    }
    return out;
}

const SIDES = 3;  // beside each other, at most

const FIELD_OF_VIEW = 40 * Math.PI / 180;

// Where the eye is and the clip matrix; closed in the angles, so that straight down is not a special case.
function camera(view, aspect) {
    const a = view.azimuth * Math.PI / 180, e = view.elevation * Math.PI / 180;
    const back = [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)];
    const right = [Math.cos(a), 0, -Math.sin(a)];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
        back[0] * right[1] - back[1] * right[0]];
    const eye = SHAPES[view.shape].target.map((t, i) => t + view.distance * back[i]);
    const along = (axis) => -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2]);
    const world = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
        along(right), along(up), along(back), 1];
    return { eye, clip: product(perspective(FIELD_OF_VIEW, aspect, view.distance / 100, view.distance + 60), world) };
}

// A light set turned: its +z to the given azimuth and height, in degrees. At (0, 0) it is as it came.
function turnedLights(directions, azimuth, height) {
    const a = azimuth * Math.PI / 180, h = height * Math.PI / 180;
    return directions.map(([x, y, z]) => {
        const y1 = y * Math.cos(h) + z * Math.sin(h), z1 = z * Math.cos(h) - y * Math.sin(h);
        return [x * Math.cos(a) + z1 * Math.sin(a), y1, z1 * Math.cos(a) - x * Math.sin(a)];
    });
}

class Renderer {
    constructor(canvas, scene) {
        this.scene = scene;
        this.gl = canvas.getContext('webgl2', { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
        const gl = this.gl;
        if (!gl) throw new Error('This browser shows no WebGL 2: open the page in another one, or allow hardware acceleration.');
        const full = gl.getExtension('EXT_color_buffer_float');
        if (!full && !gl.getExtension('EXT_color_buffer_half_float')) {
            throw new Error('This device cannot render to floating-point textures, which the comparison needs.');
        }
        this.targetFormat = full ? gl.RGBA32F : gl.RGBA16F;
        this.targetType = full ? gl.FLOAT : gl.HALF_FLOAT;
        this.programs = new Map();
        this.meshes = new Map();
        this.stacks = new Map();
        this.screen = this.program('screen', SCREEN_VERTEX_SHADER, SCREEN_FRAGMENT_SHADER);
        this.filter = this.filterTable(scene.filter);
        this.size = [0, 0];
    }

    program(key, vertex, fragment) {
        if (this.programs.has(key)) return this.programs.get(key);
        const gl = this.gl, handle = gl.createProgram();
        for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
            const shader = gl.createShader(type);
            gl.shaderSource(shader, source);
            gl.compileShader(shader);
            gl.attachShader(handle, shader);
            if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
                throw new Error(`The shader of ${key} does not compile here: ${gl.getShaderInfoLog(shader)}`);
            }
        }
        gl.linkProgram(handle);
        if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
            throw new Error(`The shader of ${key} does not link here: ${gl.getProgramInfoLog(handle)}`);
        }
        const uniforms = {};
        for (let i = 0; i < gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS); ++i) {
            const name = gl.getActiveUniform(handle, i).name.replace('[0]', '');
            uniforms[name] = gl.getUniformLocation(handle, name);
        }
        this.programs.set(key, { handle, uniforms });
        return this.programs.get(key);
    }

    // Offsets and signed weights of the pixel filter at equally likely places, one row of texels.
    filterTable(filter) {
        const gl = this.gl, table = new Float32Array(filter.offsets.flatMap((offset, i) => [offset, filter.weights[i]]));
        const texture = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG32F, filter.offsets.length, 1, 0, gl.RG, gl.FLOAT, table);
        this.nearest();
        return texture;
    }

    nearest() {
        const gl = this.gl;
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }

    // Every level is uploaded as it was baked: none is made here. A page on disk holds packed texels, others the arrays.
    async load() {
        const gl = this.gl, { images, texels } = this.scene;
        const loaded = Array.isArray(texels) ? texels : await unpacked(texels, images);
        this.scene.texels = null;
        images.forEach((stack, number) => {
            this.stacks.set(stack, stack.srgb.map((srgb, index) => {
                const format = stack.half ? gl.RGBA16F : srgb ? gl.SRGB8_ALPHA8 : gl.RGBA8;
                const texture = gl.createTexture();
                gl.bindTexture(gl.TEXTURE_2D, texture);
                loaded[number].forEach((textures, level) => {
                    const [height, width] = stack.sizes[level], type = stack.half ? gl.HALF_FLOAT : gl.UNSIGNED_BYTE;
                    gl.texImage2D(gl.TEXTURE_2D, level, format, width, height, 0, gl.RGBA, type, textures[index]);
                });
                gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, stack.sizes.length - 1);
                gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
                gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
                [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T].forEach((axis, i) =>
                    gl.texParameteri(gl.TEXTURE_2D, axis, stack.wrap[i] === 'wrap' ? gl.REPEAT : gl.CLAMP_TO_EDGE));
                return texture;
            }));
        });
    }

    mesh(shape) {
        if (this.meshes.has(shape)) return this.meshes.get(shape);
        const gl = this.gl, made = SHAPES[shape].mesh(), array = gl.createVertexArray();
        gl.bindVertexArray(array);
        [[made.positions, 3], [made.normals, 3], [made.tangents, 3], [made.uvs, 2]].forEach(([values, size], slot) => {
            gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
            gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
            gl.enableVertexAttribArray(slot);
            gl.vertexAttribPointer(slot, size, gl.FLOAT, false, 0, 0);
        });
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(made.indices), gl.STATIC_DRAW);
        gl.bindVertexArray(null);
        this.meshes.set(shape, { array, count: made.indices.length });
        return this.meshes.get(shape);
    }

    resize(width, height) {
        if (this.size[0] === width && this.size[1] === height) return false;
        const gl = this.gl;
        for (const side of this.sides ?? []) {
            for (const { texture, framebuffer } of side) {
                gl.deleteTexture(texture);
                gl.deleteFramebuffer(framebuffer);
            }
        }
        gl.deleteRenderbuffer(this.depth ?? null);
        this.size = [width, height];
        this.depth = gl.createRenderbuffer();
        gl.bindRenderbuffer(gl.RENDERBUFFER, this.depth);
        gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
        // Two targets for each side: the reference reads the mean of its passes so far from one and writes the other.
        this.sides = Array.from({ length: SIDES }, () => [0, 1].map(() => {
            const texture = gl.createTexture(), framebuffer = gl.createFramebuffer();
            gl.bindTexture(gl.TEXTURE_2D, texture);
            gl.texImage2D(gl.TEXTURE_2D, 0, this.targetFormat, width, height, 0, gl.RGBA, this.targetType, null);
            this.nearest();
            gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
            gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
            gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
            return { texture, framebuffer };
        }));
        return true;
    }

    bind(program, unit, name, texture) {
        if (!(name in program.uniforms)) return;
        this.gl.activeTexture(this.gl.TEXTURE0 + unit);
        this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
        this.gl.uniform1i(program.uniforms[name], unit);
    }

    // Draws the columns from `left` to `right` of a side, of a picture from column `from` to `to`: a stack once per pixel
    // (samples = 0), or `samples` of the reference after `gathered` others.
    drawSide(index, stack, view, samples, gathered, [left, right], [from, to]) {
        const gl = this.gl, [front, back] = this.sides[index], width = to - from, height = this.size[1];
        if (right <= left || to <= from) return;
        const program = this.program(stack.model, VERTEX_SHADER, fragmentShader(stack.model));
        const shape = SHAPES[view.shape], lights = this.scene.lights[view.lights], { eye, clip } = camera(view, width / height);
        const u = program.uniforms, flat = (rows) => new Float32Array(rows.flat());
        gl.bindFramebuffer(gl.FRAMEBUFFER, back.framebuffer);
        gl.viewport(from, 0, width, height);
        gl.enable(gl.SCISSOR_TEST);
        gl.scissor(left, 0, right - left, height);
        gl.enable(gl.DEPTH_TEST);
        gl.enable(gl.CULL_FACE);
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
        gl.useProgram(program.handle);
        this.stacks.get(stack).forEach((texture, i) => this.bind(program, i, `uMap${i}`, texture));
        this.bind(program, 3, 'uFilter', this.filter);
        this.bind(program, 4, 'uPrevious', front.texture);
        const [rows, columns] = stack.sizes[0], tiles = shape.tiles * view.tiling;
        // Where a texture repeats, texels are square; where it does not, it spans the surface once.
        const tiling = [tiles, tiles * columns / rows].map((t, i) => (stack.wrap[i] === 'wrap' ? t : 1 / shape.span));
        gl.uniformMatrix4fv(u.uClip, false, clip);
        gl.uniform2f(u.uTiling, ...tiling);
        gl.uniform2f(u.uShift, ...tiling.map((t, i) => (stack.wrap[i] === 'wrap' ? Math.floor(t * shape.span / 2) : 0)));
        gl.uniform2f(u.uSigned, ...(stack.half ? [1, 0] : [2, -1]));
        gl.uniform1f(u.uLastLevel, stack.sizes.length - 1);
        gl.uniform3f(u.uEye, ...eye);
        gl.uniform1i(u.uLights, lights.directions.length);
        gl.uniform3fv(u.uDirection, flat(turnedLights(lights.directions, view.lightAzimuth, view.lightHeight)));
        gl.uniform3fv(u.uRadiance, flat(lights.radiance));
        gl.uniform1f(u.uWiden, view.widen ** 4);
        gl.uniform1i(u.uShow, view.show);
        gl.uniform1i(u.uSamples, samples);
        gl.uniform2f(u.uStart, (gathered * 0.7548776662466927) % 1, (gathered * 0.5698402909980532) % 1);
        gl.uniform1f(u.uBlend, samples / Math.max(gathered + samples, 1));
        const mesh = this.mesh(view.shape);
        gl.bindVertexArray(mesh.array);
        gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
        gl.bindVertexArray(null);
        gl.disable(gl.SCISSOR_TEST);
        this.sides[index].reverse();
    }

    // Composes the first `count` sides, with dividers at the given columns.
    present(view, count, dividers, background) {
        const gl = this.gl, program = this.screen, [width, height] = this.size;
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        gl.viewport(0, 0, width, height);
        gl.disable(gl.DEPTH_TEST);
        gl.useProgram(program.handle);
        this.sides.forEach(([{ texture }], index) => this.bind(program, index, `uSide${index}`, texture));
        gl.uniform1i(program.uniforms.uLast, count - 1);
        gl.uniform1i(program.uniforms.uDiffer, view.differ ? 1 : 0);
        gl.uniform1i(program.uniforms.uTonemap, view.show === 0 ? 1 : 0);
        gl.uniform2f(program.uniforms.uDividers, dividers[0] ?? width, dividers[1] ?? width);
        gl.uniform1f(program.uniforms.uExposure, 2 ** view.exposure);
        gl.uniform1f(program.uniforms.uGain, view.gain);
        gl.uniform3f(program.uniforms.uBackground, ...background);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    // Linear radiance of a side, and 1 where there is a surface: RGBA, bottom row first.
    read(index) {
        const gl = this.gl, [width, height] = this.size, values = new Float32Array(width * height * 4);
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.sides[index][0].framebuffer);
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        for (let i = 3; i < values.length; i += 4) {
            if (values[i] === 0) continue;
            const weight = values[i];
            for (let channel = i - 3; channel <= i; ++channel) values[channel] /= weight;
        }
        return values;
    }
}
