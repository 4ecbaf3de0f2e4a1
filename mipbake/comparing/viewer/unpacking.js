// Texels of a page: packing.py, which has the words, backwards. A plane lies within a border of zeros.

const FIRST = 1, SHIFT = 12;

async function inflated(base64) {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

function halved(finer, height, width) {
    const from = 2 * width + 2, to = width + 2, made = new Uint8Array((height + 2) * to);
    for (let y = 0; y < height; ++y) {
        for (let x = 0; x < width; ++x) {
            const at = (2 * y + 1) * from + 2 * x + 1;
            made[(y + 1) * to + x + 1] = (finer[at] + finer[at + 1] + finer[at + from] + finer[at + from + 1] + 2) >> 2;
        }
    }
    return made;
}

// One plane of what is left, from `read` on, with the features [plane, offset] beyond its own neighbours.
function predicted(left, read, height, width, weights, features) {
    const row = width + 2, plane = new Uint8Array((height + 2) * row), total = new Int32Array(plane.length);
    total.fill(1 << (SHIFT - 1));
    features.forEach(([other, offset], index) => {
        const weight = weights[4 + index];
        for (let i = row + 1; i < total.length - row - 1; ++i) total[i] += weight * other[i + offset];
    });
    const [w, n, nw, ne] = weights;
    for (let y = 1; y <= height; ++y) {
        for (let i = y * row + 1, end = i + width; i < end; ++i) {
            const sum = total[i] + w * plane[i - 1] + n * plane[i - row] + nw * plane[i - row - 1] + ne * plane[i - row + 1];
            plane[i] = Math.min(Math.max(sum >> SHIFT, 0), 255) + left[read++];
        }
    }
    return plane;
}

function interleaved(planes, height, width) {
    const texels = new Uint8Array(height * width * planes.length);
    planes.forEach((plane, byte) => {
        for (let y = 0, write = byte; y < height; ++y) {
            for (let i = (y + 1) * (width + 2) + 1, end = i + width; i < end; ++i, write += planes.length) texels[write] = plane[i];
        }
    });
    return planes.length === 8 ? new Uint16Array(texels.buffer) : texels;
}

// Of every stack, by level and texture, its interleaved texels.
async function unpacked({ data, weights }, stacks) {
    const left = await inflated(data);
    let read = 0, number = 0, before = null;
    return stacks.map((stack) => {
        const bytes = stack.half ? 8 : 4, order = [FIRST, ...[...Array(bytes).keys()].filter((byte) => byte !== FIRST)];
        const levels = [], related = before?.stack.model === stack.model && before.stack.half === stack.half;
        stack.sizes.forEach(([height, width], level) => {
            const row = width + 2, like = related ? before.stack.sizes[level] : null;
            const same = like && like[0] === height && like[1] === width;
            const [tall, wide] = level ? stack.sizes[level - 1] : [0, 0], exact = tall === 2 * height && wide === 2 * width;
            levels.push(stack.srgb.map((_, texture) => {
                const planes = [];
                for (const byte of order) {
                    const features = [];
                    if (byte !== FIRST) for (const offset of [0, -1, -row]) features.push([planes[FIRST], offset]);
                    if (same) for (const offset of [0, -1, 1, -row, row]) features.push([before.levels[level][texture][byte], offset]);
                    if (exact) features.push([halved(levels[level - 1][texture][byte], height, width), 0]);
                    planes[byte] = predicted(left, read, height, width, weights[number++], features);
                    read += height * width;
                }
                return planes;
            }));
        });
        before = { stack, levels };
        return levels.map((textures, level) => textures.map((planes) => interleaved(planes, ...stack.sizes[level])));
    });
}
