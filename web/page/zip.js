// Archives: a reader of .zip files, and a writer that stores what is compressed already.

const END = 0x06054b50, ENTRY = 0x02014b50, LOCAL = 0x04034b50;
const MOST_BYTES = 4 * 2 ** 30;

/**
 * The files in an archive, by name. Folders, and what macOS adds, are left out.
 * @param {Blob} archive @returns {Promise<{name: string, blob: () => Promise<Blob>}[]>}
 */
export async function unzipped(archive) {
    const tail = Math.min(archive.size, 65557), end = new DataView(await archive.slice(archive.size - tail).arrayBuffer());
    let at = end.byteLength - 22;
    while (at >= 0 && end.getUint32(at, true) !== END) --at;
    if (at < 0) throw new Error('it is no .zip archive, or a part of it is missing');
    const count = end.getUint16(at + 10, true), size = end.getUint32(at + 12, true), start = end.getUint32(at + 16, true);
    if (count === 0xffff || start === 0xffffffff) throw new Error('it is a .zip archive of more than 4 GB: unpack it, and drop the folder');
    const list = new DataView(await archive.slice(start, start + size).arrayBuffer()), text = new TextDecoder(), found = [];
    let total = 0;
    for (let i = 0, entry = 0; i < count; ++i) {
        if (entry + 46 > list.byteLength || list.getUint32(entry, true) !== ENTRY) throw new Error('its list of files is broken');
        const [flags, method] = [8, 10].map((offset) => list.getUint16(entry + offset, true));
        const [packed, unpacked] = [20, 24].map((offset) => list.getUint32(entry + offset, true));
        const [name, extra, comment] = [28, 30, 32].map((offset) => list.getUint16(entry + offset, true));
        const place = list.getUint32(entry + 42, true), path = text.decode(new Uint8Array(list.buffer, entry + 46, name));
        entry += 46 + name + extra + comment;
        if (path.endsWith('/') || path.startsWith('__MACOSX/') || path.split('/').at(-1).startsWith('.')) continue;
        total += unpacked;
        found.push({ name: path, blob: () => entryOf(archive, { path, flags, method, packed, unpacked, place }) });
    }
    if (total > MOST_BYTES) throw new Error('it unpacks to more than 4 GB');
    return found;
}

async function entryOf(archive, { path, flags, method, packed, unpacked, place }) {
    if (flags & 1) throw new Error(`${path} is encrypted: unpack the archive, and drop the folder`);
    if (method !== 0 && method !== 8) throw new Error(`${path} is packed by a method that browsers do not unpack: unpack the archive, and drop the folder`);
    const head = new DataView(await archive.slice(place, place + 30).arrayBuffer());
    if (head.byteLength < 30 || head.getUint32(0, true) !== LOCAL) throw new Error(`${path} is broken in the archive`);
    const start = place + 30 + head.getUint16(26, true) + head.getUint16(28, true), bytes = archive.slice(start, start + packed);
    if (method === 0) return bytes;
    const parts = [];
    let length = 0;
    try {
        const reader = bytes.stream().pipeThrough(new DecompressionStream('deflate-raw')).getReader();
        for (let part = await reader.read(); !part.done; part = await reader.read()) {
            length += part.value.length;
            if (length > unpacked) throw new Error('it is longer than the archive says');
            parts.push(part.value);
        }
    } catch {
        throw new Error(`${path} is broken in the archive`);
    }
    return new Blob(parts);
}

const TABLE = Uint32Array.from({ length: 256 }, (_, value) => {
    for (let bit = 0; bit < 8; ++bit) value = value & 1 ? 0xedb88320 ^ (value >>> 1) : value >>> 1;
    return value;
});

/** @param {Uint8Array} bytes */
export function crc32(bytes, before = 0) {
    let crc = ~before;
    for (const byte of bytes) crc = TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
    return ~crc >>> 0;
}

/**
 * An archive of files as they are.
 * @param {{name: string, bytes: Uint8Array}[]} files @returns {Blob}
 */
export function zipped(files) {
    const parts = [], list = [], text = new TextEncoder();
    let at = 0;
    for (const { name, bytes } of files) {
        const path = text.encode(name), crc = crc32(bytes);
        // Version 2.0, names in UTF-8, stored, and the first day that the format knows: equal files make equal archives.
        const shared = [20, 0x800, 0, 0, 33, ...words(crc), ...words(bytes.length), ...words(bytes.length), path.length, 0];
        const head = new Uint16Array([...words(LOCAL), ...shared]);
        list.push(new Uint16Array([...words(ENTRY), 20, ...shared, 0, 0, 0, 0, 0, ...words(at)]), path);
        parts.push(head, path, bytes);
        at += head.byteLength + path.length + bytes.length;
    }
    const size = list.reduce((sum, part) => sum + part.byteLength, 0);
    const end = new Uint16Array([...words(END), 0, 0, files.length, files.length, ...words(size), ...words(at), 0]);
    return new Blob([...parts, ...list, end], { type: 'application/zip' });
}

const words = (value) => [value & 0xffff, value >>> 16];
