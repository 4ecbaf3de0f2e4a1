// Keeps the page and all that it loads, so that it opens without a network. web/page_build.py fills in the two names.
const VERSION = '', FILES = [];

self.addEventListener('install', (event) => {
    event.waitUntil(caches.open(VERSION).then((kept) => kept.addAll(FILES)).then(() => self.skipWaiting()));
});

self.addEventListener('activate', (event) => {
    const old = async () => Promise.all((await caches.keys()).filter((name) => name.startsWith('mipbake ') && name !== VERSION).map((name) => caches.delete(name)));
    event.waitUntil(old().then(() => self.clients.claim()));
});

self.addEventListener('fetch', (event) => {
    if (event.request.method !== 'GET' || new URL(event.request.url).origin !== location.origin) return;
    event.respondWith(caches.open(VERSION).then((kept) => kept.match(event.request, { ignoreSearch: true })).then((found) => found ?? fetch(event.request)));
});
