// Colours between linear and sRGB-encoded values of 0 to 1: mipbake/base/srgb.py has the same in Python.

/** @param {number} value encoded */
export function toLinear(value) {
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}

/** @param {number} value linear */
export function toEncoded(value) {
    return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}

const RANGES = 4096; // of 0 to 1, so many that few have more than two bytes
const first = new Uint8Array(RANGES + 1); // what stands for the least value of a range
const least = new Float32Array(257).fill(Infinity); // value that each byte stands for

/**
 * The byte that stands for a linear value of 32 bits: what rounds `toEncoded`, found without its power.
 * @param {number} value
 */
export function toByte(value) {
    if (least[0]) fill();
    const within = value > 0 ? (value < 1 ? value : 1) : 0; // 0 of NaN
    let byte = first[Math.floor(within * RANGES)];
    while (within >= least[byte + 1]) byte++;
    return byte;
}

function fill() {
    const rounded = (/** @type {number} */ value) => Math.floor(toEncoded(value) * 255 + 0.5);
    const bits = new Int32Array(least.buffer);
    for (let byte = 1; byte < 256; byte++) {
        least[byte] = toLinear((byte - 0.5) / 255);
        while (rounded(least[byte]) >= byte) bits[byte]--; // to the number of 32 bits before
        while (rounded(least[byte]) < byte) bits[byte]++;
    }
    first.forEach((_, i) => (first[i] = rounded(i / RANGES)));
    least[0] = 0;
}
