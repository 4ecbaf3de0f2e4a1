// What scripts add to the page: the divider and the zoom, films that loop in step, curves that can be picked out and read
// off, tables that sort.

const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function make(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
}

// ---- pictures: A left of a divider, B right of it, in every scene

class Scene {
    constructor(root, choice) {
        Object.assign(this, { root, choice, at: 50, x: 0.5, y: 0.5 });
        this.cells = new Map(all('.strip > figure', root).map((cell) => [cell.dataset.method, cell]));
        this.sides = ['a', 'b'].map((side) => make('div', { class: `side ${side}` }, this.pane()));
        this.tags = ['left', 'right'].map((place) => make('span', { class: `tag ${place}` }));
        this.divider = make('div', {
            class: 'divider', role: 'slider', tabindex: 0, 'aria-orientation': 'horizontal', 'aria-valuemin': 0, 'aria-valuemax': 100,
            'aria-label': `Divider between A and B: ${root.dataset.title}`,
        });
        this.stage = make('div', { class: 'stage' }, ...this.sides, ...this.tags, this.divider);
        this.measured = make('table', { class: 'measured' });
        this.holder = root.querySelector('.compare');
        this.holder.append(this.stage, this.measured);
        this.holder.hidden = false;
        this.listen();
        new ResizeObserver(() => this.fit()).observe(this.holder);
    }

    // What a side of the divider holds.
    pane() {
        return new Image();
    }

    // What a side shows of a picture of the strip.
    show(side, source) {
        const image = this.sides[side].firstChild;
        if (image.src !== source.src) Object.assign(image, { src: source.src, alt: source.alt });
    }

    // Width and height in pixels of the picture.
    size() {
        const reference = this.cells.get(this.choice.reference).querySelector('.render');
        return [Number(reference.getAttribute('width')), Number(reference.getAttribute('height'))];
    }

    // Whole device pixels for each of the picture's: uneven ones would look like the errors that this page is about.
    fit() {
        const [width, height] = this.size();
        const ratio = devicePixelRatio || 1, room = this.holder.clientWidth;
        const factor = Math.floor(room * ratio / width + 1e-6);
        const exact = factor >= 1 && factor * width > 0.75 * room * ratio;  // else a smooth picture beats a small one
        this.width = exact ? factor * width / ratio : room;
        this.height = this.width * height / width;
        this.stage.style.width = `${this.width}px`;
        this.stage.style.height = `${this.height}px`;
        this.stage.classList.toggle('crisp', exact || room * ratio * this.choice.zoom > 5 * width);
        this.move();
    }

    update() {
        const flip = this.choice.show === 'flip', names = [this.choice.a, this.choice.b];
        const figures = names.map((name) => JSON.parse(this.cells.get(name)?.dataset.figures ?? '{}'));
        names.forEach((name, side) => {
            const cell = this.cells.get(name);
            const source = cell?.querySelector(flip ? '.flip' : '.render');
            this.sides[side].hidden = !source;
            if (source) this.show(side, source);
            this.tags[side].textContent = source ? name : `${name}: ${flip ? 'no FLIP map' : 'not rendered'}`;
        });
        for (const [name, cell] of this.cells) {
            const places = ['A', 'B'].filter((_, side) => names[side] === name).join(' ');
            if (places) cell.dataset.at = places; else delete cell.dataset.at;
        }
        const measures = [...new Set(figures.flatMap(Object.keys))];
        this.measured.replaceChildren(
            make('thead', {}, make('tr', {}, make('td'), ...names.map((name) => make('th', { scope: 'col' }, name)))),
            make('tbody', {}, ...measures.map((measure) => make('tr', {}, make('th', { scope: 'row' }, measure),
                ...figures.map((found) => make('td', {}, found[measure] ?? '–'))))));
        this.measured.hidden = !measures.length;
        const zoomed = this.choice.zoom > 1;
        this.stage.classList.toggle('zoomed', zoomed);
        if (zoomed) {
            const label = `${this.root.dataset.title}, enlarged: arrow keys move the picture`;
            Object.entries({ tabindex: 0, role: 'group', 'aria-label': label }).forEach(([k, v]) => this.stage.setAttribute(k, v));
        } else ['tabindex', 'role', 'aria-label'].forEach((name) => this.stage.removeAttribute(name));
        this.fit();
    }

    move() {
        const zoom = this.choice.zoom, half = 0.5 / zoom;
        this.x = clamp(this.x, half, 1 - half);
        this.y = clamp(this.y, half, 1 - half);
        const ratio = devicePixelRatio || 1, whole = (x) => Math.round(x * ratio) / ratio;
        const [left, top] = [whole(this.width * (0.5 - this.x * zoom)), whole(this.height * (0.5 - this.y * zoom))];
        for (const side of this.sides) side.firstChild.style.transform = `translate(${left}px, ${top}px) scale(${zoom})`;
        this.stage.style.setProperty('--divider', `${this.at}%`);
        this.divider.setAttribute('aria-valuenow', Math.round(this.at));
        this.divider.setAttribute('aria-valuetext', `${Math.round(this.at)} %, ${this.choice.a} to the left, ${this.choice.b} to the right`);
    }

    divide(at) {
        this.at = clamp(at, 0, 100);
        this.move();
    }

    listen() {
        let dragged = null;
        const place = (event) => 100 * (event.clientX - this.stage.getBoundingClientRect().left) / this.width;
        this.stage.addEventListener('pointerdown', (event) => {
            if (event.button) return;
            dragged = this.choice.zoom > 1 && event.target !== this.divider ? event : 'divider';
            this.stage.setPointerCapture(event.pointerId);
            if (dragged === 'divider' && event.pointerType === 'mouse') this.divide(place(event));
        });
        this.stage.addEventListener('pointermove', (event) => {
            if (dragged === 'divider') this.divide(place(event));
            else if (dragged) {
                this.x -= (event.clientX - dragged.clientX) / (this.width * this.choice.zoom);
                this.y -= (event.clientY - dragged.clientY) / (this.height * this.choice.zoom);
                dragged = event;
                this.move();
            }
        });
        for (const end of ['pointerup', 'pointercancel']) this.stage.addEventListener(end, () => { dragged = null; });
        this.divider.addEventListener('keydown', (event) => {
            const step = { ArrowLeft: -2, ArrowDown: -2, ArrowRight: 2, ArrowUp: 2, PageDown: -10, PageUp: 10, Home: -100, End: 100 }[event.key];
            if (!step || event.ctrlKey || event.altKey || event.metaKey) return;
            event.preventDefault();
            event.stopPropagation();
            this.divide(this.at + step);
        });
        this.stage.addEventListener('keydown', (event) => {
            const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
            if (!step || event.target !== this.stage || event.ctrlKey || event.altKey || event.metaKey) return;
            event.preventDefault();
            this.x += 0.1 * step[0] / this.choice.zoom;
            this.y += 0.1 * step[1] / this.choice.zoom;
            this.move();
        });
        for (const [name, cell] of this.cells) {
            cell.addEventListener('click', (event) => this.choice.pick(event.shiftKey ? 'b' : 'a', name));
        }
    }
}

// ---- films: frames below each other in one picture for each method, drawn on canvases from one clock

class Film extends Scene {
    constructor(root, choice) {
        super(root, choice);
        this.frames = Number(root.dataset.frames);
        this.seen = true;
        new IntersectionObserver(([entry]) => { this.seen = entry.isIntersecting; this.draw(); }).observe(root);
        for (const cell of this.cells.values()) {
            const sheet = cell.querySelector('.render');
            sheet.after(this.canvas());
            sheet.hidden = true;
            sheet.decode().then(() => this.draw());
        }
    }

    size() {
        const sheet = this.cells.get(this.choice.reference).querySelector('.render');
        return [Number(sheet.getAttribute('width')), Number(sheet.getAttribute('height')) / Number(this.root.dataset.frames)];
    }

    canvas() {
        const sheet = this.root.querySelector('.render');
        const height = Number(sheet.getAttribute('height')) / Number(this.root.dataset.frames);
        return make('canvas', { width: sheet.getAttribute('width'), height, role: 'img' });
    }

    pane() {
        return this.canvas();
    }

    show(side, source) {
        const canvas = this.sides[side].firstChild;
        canvas.setAttribute('aria-label', source.alt);
        canvas.sheet = source;
        this.paint(canvas, source);
    }

    draw() {
        if (!this.seen) return;
        for (const { firstChild: canvas } of this.sides) if (canvas.sheet) this.paint(canvas, canvas.sheet);
        for (const cell of this.cells.values()) this.paint(cell.querySelector('canvas'), cell.querySelector('.render'));
    }

    paint(canvas, sheet) {
        if (!canvas || !sheet.complete) return;
        canvas.setAttribute('aria-label', sheet.alt);
        const { width, height } = canvas;
        canvas.getContext('2d').drawImage(sheet, 0, this.frame() * height, width, height, 0, 0, width, height);
    }

    // Forwards and then backwards: a jump from the last frame to the first would hide what shimmers.
    frame() {
        const period = Math.max(2 * (this.frames - 1), 1), at = ((this.choice.tick % period) + period) % period || 0;
        return Math.min(at, period - at);
    }
}

// Counts frames, for all films at once. It stands still at first where a reader wants less motion.
class Clock {
    constructor(section, films, choice) {
        Object.assign(this, { films, choice, since: null });
        this.fps = Number(films[0].root.dataset.fps);
        this.buttons = new Map(all('[data-do]', section).map((button) => [button.dataset.do, button]));
        this.output = section.querySelector('.clock output');
        this.buttons.get('play').addEventListener('click', () => this.run(!this.running));
        this.buttons.get('back').addEventListener('click', () => this.step(-1));
        this.buttons.get('on').addEventListener('click', () => this.step(1));
        section.tabIndex = -1;  // what is clicked takes the keys
        section.addEventListener('keydown', (event) => {
            if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest('select, input')) return;
            if (event.key === ' ' && !event.target.closest('button, a')) this.run(!this.running);
            else if (event.key === ',' || event.key === '.') this.step(event.key === ',' ? -1 : 1);
            else return;
            event.preventDefault();
        });
        this.run(!matchMedia('(prefers-reduced-motion: reduce)').matches);
        this.tell();
    }

    run(running) {
        this.running = running;
        this.since = null;
        this.buttons.get('play').textContent = running ? 'Stop' : 'Play';
        if (running) requestAnimationFrame((now) => this.tick(now));
        else this.tell();
    }

    tick(now) {
        if (!this.running) return;
        this.since ??= now - (this.choice.tick * 1000) / this.fps;
        const tick = Math.floor(((now - this.since) * this.fps) / 1000);
        if (tick !== this.choice.tick) this.go(tick);
        requestAnimationFrame((later) => this.tick(later));
    }

    step(by) {
        this.run(false);
        this.go(this.choice.tick + by);
        this.tell();
    }

    go(tick) {
        this.choice.tick = tick;
        this.films.forEach((film) => film.draw());
    }

    // While films run, a number that changes all the time would only distract.
    tell() {
        this.output.textContent = this.running ? '' : `frame ${this.films[0].frame() + 1} of ${this.films[0].frames}`;
    }
}

all('.bar').forEach((bar) => {
    const { a, b, reference } = JSON.parse(bar.dataset.settings), section = bar.closest('section');
    const choice = { a, b, reference, show: 'render', zoom: 1, tick: 0 };
    const films = all('.scene.film', section).map((root) => new Film(root, choice));
    const scenes = [...films, ...all('.scene:not(.film)', section).map((root) => new Scene(root, choice))];
    const update = () => scenes.forEach((scene) => scene.update());
    const selects = new Map(all('select', bar).map((select) => [select.name, select]));
    choice.pick = (side, name) => {
        choice[side] = name;
        selects.get(side).value = name;
        update();
    };
    for (const [key, select] of selects) {
        select.addEventListener('change', () => {
            choice[key] = key === 'zoom' ? Number(select.value) : select.value;
            update();
        });
    }
    update();
    if (films.length) new Clock(section, films, choice);
});

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
