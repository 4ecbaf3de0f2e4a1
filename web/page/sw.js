// Keeps the page and all that it loads, so that it opens without a network. web/page_build.py fills in the two names.
const VERSION = '', FILES = [];

// A browser takes one of two cores: src/core.js says which.
const SIMD = new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 8, 1, 6, 0, 65, 0, 253, 15, 11]);
const OTHER = WebAssembly.validate(SIMD) ? 'dist/bakes-scalar.wasm' : 'dist/bakes.wasm';

self.addEventListener('install', (event) => {
    event.waitUntil(caches.open(VERSION).then((kept) => kept.addAll(FILES.filter((name) => name !== OTHER))).then(() => self.skipWaiting()));
});

self.addEventListener('activate', (event) => {
    const old = async () => Promise.all((await caches.keys()).filter((name) => name.startsWith('mipbake ') && name !== VERSION).map((name) => caches.delete(name)));
    event.waitUntil(old().then(() => self.clients.claim()));
});

self.addEventListener('fetch', (event) => {
    if (event.request.method !== 'GET' || new URL(event.request.url).origin !== location.origin) return;
    event.respondWith(caches.open(VERSION).then((kept) => kept.match(event.request, { ignoreSearch: true })).then((found) => found ?? fetch(event.request)));
});
