// What scripts add to the page: films that loop in step, curves that can be picked out and read off, tables that sort.

const all = (selector, root = document) => [...root.querySelectorAll(selector)];

function make(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
}

// ---- pixels of pictures cover whole pixels of the screen: uneven ones would look like the errors that this page is about

function fit() {
    const ratio = devicePixelRatio || 1;
    document.documentElement.style.setProperty('--pixel', Math.max(Math.floor(ratio), 1) / ratio);
    for (const film of films) film.fit(ratio);
}

// ---- films: frames below each other in one picture for each method, drawn on canvases from one clock

class Film {
    constructor(root, clock) {
        Object.assign(this, { root, clock, frames: Number(root.dataset.frames), seen: true });
        this.sheets = all('.sheet', root).map((sheet) => {
            const width = Number(sheet.getAttribute('width')), height = Number(sheet.getAttribute('height')) / this.frames;
            const canvas = make('canvas', { width, height, role: 'img', 'aria-label': sheet.alt });
            sheet.after(canvas);
            sheet.hidden = true;
            sheet.decode().then(() => this.draw());
            return { sheet, canvas };
        });
        new IntersectionObserver(([entry]) => { this.seen = entry.isIntersecting; this.draw(); }).observe(root);
    }

    // As many films beside each other as are wanted; no larger than their pixels warrant.
    fit(ratio) {
        const { width } = this.sheets[0]?.canvas ?? {}, strip = this.root.querySelector('.strip');
        if (!width || this.root.closest('.others')) return;
        const beside = innerWidth < 600 ? 2 : this.sheets.length, words = innerWidth < 768 ? 0 : 240;
        const room = Math.floor((this.root.clientWidth - words - 4 - 8 * (beside - 1)) / beside);
        const factor = Math.min(Math.floor(room * ratio / width), Math.max(Math.floor(ratio), 1));
        strip.style.setProperty('--width', `${factor ? factor * width / ratio : room}px`);
        strip.classList.toggle('smooth', !factor);
    }

    // Forwards and then backwards: a jump from the last frame to the first would hide what shimmers.
    frame() {
        const period = Math.max(2 * (this.frames - 1), 1), at = ((this.clock.now % period) + period) % period || 0;
        return Math.min(at, period - at);
    }

    draw() {
        if (!this.seen) return;
        for (const { sheet, canvas } of this.sheets) {
            const { width, height } = canvas;
            if (sheet.complete) canvas.getContext('2d').drawImage(sheet, 0, this.frame() * height, width, height, 0, 0, width, height);
        }
    }
}

// Counts frames, for all films at once. It stands still at first where a reader wants less motion.
class Clock {
    constructor() {
        Object.assign(this, { now: 0, since: null, films: all('.film').map((root) => new Film(root, this)) });
        const bar = document.querySelector('.clock');
        if (!bar) return;
        this.fps = Number(this.films[0].root.dataset.fps);
        this.output = bar.querySelector('output');
        this.buttons = new Map(all('[data-do]', bar).map((button) => [button.dataset.do, button]));
        this.buttons.get('play').addEventListener('click', () => this.run(!this.running));
        this.buttons.get('back').addEventListener('click', () => this.step(-1));
        this.buttons.get('on').addEventListener('click', () => this.step(1));
        for (const section of new Set(this.films.map(({ root }) => root.closest('section')))) {
            section.tabIndex = -1;  // what is clicked takes the keys
            section.addEventListener('keydown', (event) => {
                if (event.ctrlKey || event.altKey || event.metaKey) return;
                if (event.key === ' ' && !event.target.closest('button, a')) this.run(!this.running);
                else if (event.key === ',' || event.key === '.') this.step(event.key === ',' ? -1 : 1);
                else return;
                event.preventDefault();
            });
        }
        this.run(!matchMedia('(prefers-reduced-motion: reduce)').matches);
    }

    run(running) {
        this.running = running;
        this.since = null;
        this.buttons.get('play').textContent = running ? 'Stop' : 'Play';
        // While films run, a number that changes all the time would only distract.
        this.output.textContent = running ? '' : `frame ${this.films[0].frame() + 1} of ${this.films[0].frames}`;
        if (running) requestAnimationFrame((now) => this.tick(now));
    }

    tick(now) {
        if (!this.running) return;
        this.since ??= now - (this.now * 1000) / this.fps;
        const tick = Math.floor(((now - this.since) * this.fps) / 1000);
        if (tick !== this.now) this.go(tick);
        requestAnimationFrame((later) => this.tick(later));
    }

    step(by) {
        this.go(this.now + by);
        this.run(false);
    }

    go(tick) {
        this.now = tick;
        this.films.forEach((film) => film.draw());
    }
}

const { films } = new Clock();
fit();
addEventListener('resize', fit);

// ---- curves

const curves = document.querySelector('.curves');
if (curves) {
    // Names beside the ends of lines, a line apart: downwards from the wanted heights, then up from the bottom.
    const spread = (group) => {
        const { gap, top, bottom } = Object.fromEntries(['gap', 'top', 'bottom'].map((key) => [key, Number(group.dataset[key])]));
        const shown = all('.label.on', group).sort((p, q) => p.dataset.y - q.dataset.y);
        const heights = [];
        for (const label of shown) heights.push(Math.max(Number(label.dataset.y), heights.length ? heights.at(-1) + gap : top));
        let limit = bottom;
        for (let i = heights.length - 1; i >= 0; --i) limit = (heights[i] = Math.min(heights[i], limit)) - gap;
        shown.forEach((label, i) => label.setAttribute('y', heights[i]));
    };
    all('.legend input', curves).forEach((box) => {
        const apply = () => {
            all('[data-method]', curves).filter((part) => part !== box && part.dataset.method === box.dataset.method).forEach((part) => {
                (part.matches('.swatch') ? part.firstElementChild : part).classList.toggle('on', box.checked);
            });
            all('.labels', curves).forEach(spread);
        };
        box.addEventListener('change', apply);
        apply();  // browsers keep boxes when a page is loaded again
    });
    all('.plot', curves).forEach((plot) => {
        const svg = plot.querySelector('svg'), cursor = plot.querySelector('.cursor'), readout = plot.querySelector('.readout');
        const lines = all('.line[data-points]', svg).map((line) => ({
            line, points: new Map(line.dataset.points.split(' ').map((point) => point.split(':').map(Number))),
        }));
        const [first, last] = svg.dataset.lods.split(' ').map(Number);
        const left = Number(svg.dataset.left), width = svg.viewBox.baseVal.width - left - Number(svg.dataset.right);
        const hide = () => { cursor.hidden = readout.hidden = true; cursor.setAttribute('hidden', ''); };
        svg.addEventListener('pointermove', (event) => {
            const box = svg.getBoundingClientRect(), scale = box.width / svg.viewBox.baseVal.width;
            const wanted = first + ((event.clientX - box.left) / scale - left) / width * (last - first);
            const lods = [...new Set(lines.flatMap(({ points }) => [...points.keys()]))];
            const lod = lods.reduce((best, x) => (Math.abs(x - wanted) < Math.abs(best - wanted) ? x : best), Infinity);
            const found = lines.filter(({ line, points }) => line.classList.contains('on') && points.has(lod))
                .sort((p, q) => q.points.get(lod) - p.points.get(lod));
            if (!found.length || wanted < first - 0.3 || wanted > last + 0.3) return hide();
            const x = left + (lod - first) / Math.max(last - first, 1e-9) * width;
            cursor.setAttribute('x1', x);
            cursor.setAttribute('x2', x);
            cursor.removeAttribute('hidden');
            readout.replaceChildren(make('div', {}, `level of detail ${lod}`), ...found.map(({ line, points }) => {
                const colour = [...line.classList].find((name) => /^c\d$/.test(name));
                return make('div', {}, make('span', { class: colour }, points.get(lod).toFixed(1)), ` ${line.dataset.method}`);
            }));
            readout.hidden = false;
            const right = x > left + width / 2;
            readout.style.left = right ? 'auto' : `${x * scale + 10}px`;
            readout.style.right = right ? `${box.width - x * scale + 10}px` : 'auto';
        });
        svg.addEventListener('pointerleave', hide);
    });
}

// ---- tables

all('table.figures').forEach((table) => {
    const heads = all('thead th', table), body = table.tBodies[0], rows = [...body.rows];
    heads.forEach((head, column) => {
        const button = make('button', { type: 'button' }, ...head.childNodes);
        head.append(button);
        button.addEventListener('click', () => {
            const down = head.dataset.order === 'higher' ? 'descending' : 'ascending', up = down === 'ascending' ? 'descending' : 'ascending';
            const turned = head.getAttribute('aria-sort') === down;  // the best figures came first: now the worst
            heads.forEach((other) => other.removeAttribute('aria-sort'));
            const value = (row) => Number(row.cells[column].dataset.value ?? Infinity);
            if (column) head.setAttribute('aria-sort', turned ? up : down);
            const order = column ? [...rows].sort((p, q) => (turned ? -1 : 1) * (value(p) - value(q) || 0)) : rows;
            body.append(...order);
        });
    });
});

// ---- only what scrolls is a stop for the Tab key

const scrolling = new ResizeObserver((entries) => entries.forEach(({ target }) => {
    if (target.scrollWidth > target.clientWidth + 1) target.tabIndex = 0;
    else target.removeAttribute('tabindex');
}));
all('.scroll, .strip').forEach((part) => scrolling.observe(part));

// ---- paper shows what is folded away

let unfolded = [];
addEventListener('beforeprint', () => {
    unfolded = all('main details:not([open])').filter((details) => !details.closest('.mipbake-viewer'));
    unfolded.forEach((details) => { details.open = true; });
});
addEventListener('afterprint', () => unfolded.forEach((details) => { details.open = false; }));

// ---- a first page waits for the whole one, whose script is beside it, and is loaded again as it is looked at

if (document.getElementById('begun')) {
    globalThis.wholePage = () => {
        const { view } = document.querySelector('.mipbake-viewer')?.viewer ?? {};
        try { sessionStorage.setItem(location.pathname, JSON.stringify(view ?? {})); } catch { /* it begins anew */ }
        location.reload();
    };
    setInterval(() => {
        const script = make('script', { src: `whole.js?${Date.now()}` });
        script.onload = script.onerror = () => script.remove();
        document.head.append(script);
    }, 2000);
}
