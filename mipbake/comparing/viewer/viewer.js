// The controls around the renderer, and when to draw: on change, in motion, and while the reference gathers samples.

const SHOWN = ['Shaded', 'Diffuse albedo', 'Reflectance at normal incidence', 'Normal', 'Roughness', 'Level of detail'];
const KEYS = [
    ['arrows', 'look around'], ['+ −', 'closer, farther'], ['n m f', 'near, middle distance, far'], ['b', 'beside each other, or one picture divided'], ['[ ]', 'move the first divider'],
    ['1 2 3', 'floor, sphere, ball'], ['l', 'move the lamp'], ['space', 'move the camera'], ['d', 'differences from what is to the right'],
];
const LAMP = { degrees: 30, seconds: 7 };  // how far a lamp moves to either side, and how long it takes to be back

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
        if (value !== null) made.setAttribute(name, value);
    }
    made.append(...children);
    return made;
}

class Viewer {
    constructor(root, scene) {
        this.root = root;
        this.scene = scene;
        const [truth, stacks] = scene.source ? [scene.images[0], scene.images.slice(1)] : [null, scene.images];
        Object.assign(scene, { source: truth, stacks });
        this.choices = truth ? [...stacks, truth] : stacks;
        this.view = {
            sides: this.choices.map((_, index) => index).slice(0, SIDES), dividers: [], shape: 'plane', away: 'middle', beside: true, differ: false,
            gain: 4, exposure: 0, show: 0, widen: 0, pixels: 1, tiling: 1, distance: 5, azimuth: 0, elevation: 30,
            lights: 0, lightAzimuth: 0, lightHeight: scene.lights[0].height, lampMoves: false, cameraMoves: false,
        };
        const kept = keptView();
        Object.assign(this.view, kept);
        this.pose = 'azimuth' in kept ? 'kept' : null;  // the size of the picture that the view was posed for
        this.controls = {};
        this.each = 4;
        this.build();
        this.renderer = new Renderer(this.canvas, scene);
        this.canvas.addEventListener('webglcontextlost', () => this.fail('The graphics context was lost: load the page again.'));
        new ResizeObserver(() => this.change()).observe(this.stage);
        matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.change());
        this.change();
    }

    fail(sentence) {
        this.stage.replaceChildren(element('p', { class: 'mv-failure' }, sentence));
        this.broken = true;
    }

    // ---- what is on the page

    build() {
        this.canvas = element('canvas', {
            tabindex: 0, role: 'img', 'aria-label': 'A lit surface, a side for each picture that is chosen; arrow keys look around',
        });
        this.dividers = [0, 1].map((index) => element('div', {
            class: 'mv-divider', role: 'slider', tabindex: 0, 'aria-label': `Divider ${index + 1}`, 'aria-valuemin': 0, 'aria-valuemax': 100,
        }));
        this.names = [0, 1, 2].map(() => element('span', { class: 'mv-name' }));
        this.stage = element('div', { class: 'mv-stage' }, this.canvas, ...this.dividers, ...this.names);
        this.status = element('p', { class: 'mv-status', role: 'status' });
        const several = this.choices.length > 1, degrees = (x) => `${Math.round(x)}°`;
        const reset = element('button', { type: 'button' }, 'Reset the view');
        reset.addEventListener('click', () => this.change({ away: 'middle', lightAzimuth: 0, dividers: [] }));
        const bar = element('div', { class: 'mv-bar' },
            this.group('Distance', Object.entries(AWAY).map(([key, away]) => this.button(
                away.label, () => this.change({ away: key }), () => this.view.away === key, away.title))),
            this.group('Shape', Object.entries(SHAPES).map(([key, shape]) => this.button(
                shape.label, () => this.change({ shape: key, away: this.view.away || 'middle' }), () => this.view.shape === key))),
            this.group('Motion', [
                this.button('Move the lamp', () => this.change({ lampMoves: !this.view.lampMoves }), () => this.view.lampMoves),
                this.button('Move the camera', () => this.change({ cameraMoves: !this.view.cameraMoves }), () => this.view.cameraMoves),
            ]),
            this.slider('lightAzimuth', 'Lamp', -180, 180, 1, degrees));
        const panel = element('div', { class: 'mv-panel' },
            ...(several ? [this.group('Show', this.choices.map(({ name }, index) => this.button(
                name, () => this.toggle(index), () => this.view.sides.includes(index))))] : []),
            ...(this.scene.lights.length > 1
                ? [this.select('lights', 'Light', this.scene.lights.map((set, i) => [i, set.name]))] : []),
            this.slider('lightHeight', 'Light height', -90, 90, 1, degrees),
            this.slider('exposure', 'Exposure', -5, 5, 0.1, (x) => `${x > 0 ? '+' : ''}${x.toFixed(1)} EV`),
            this.slider('distance', 'Distance', -1, 5, 0.01, (x) => (2 ** x).toFixed(2), Math.log2, (x) => 2 ** x),
            this.slider('tiling', 'Texture scale', -5, 5, 0.1, (x) => `×${(2 ** x).toFixed(2)}`, Math.log2, (x) => 2 ** x),
            this.slider('widen', 'Added roughness', 0, 0.8, 0.01, (x) => x.toFixed(2)),
            this.select('pixels', 'Size of a pixel', [[1, 'as the screen'], [2, '×2'], [4, '×4'], [8, '×8']]),
            this.select('show', 'Channel', SHOWN.map((name, i) => [i, name])),
            ...(several ? [
                this.group('Compare', [
                    this.button('One picture, divided', () => this.change({ beside: !this.view.beside }), () => !this.view.beside),
                    this.button('Differences', () => this.change({ differ: !this.view.differ }), () => this.view.differ,
                        'how the other pictures differ from the one to the right: dark for none'),
                ]),
                this.slider('gain', 'Difference gain', 0, 5, 0.1, (x) => `×${(2 ** x).toFixed(1)}`, Math.log2, (x) => 2 ** x),
            ] : []),
            reset);
        const keys = element('dl', {}, ...KEYS.flatMap(([key, what]) => [element('dt', {}, key), element('dd', {}, what)]));
        this.root.replaceChildren(this.stage, bar, this.status,
            element('details', { class: 'mv-more' }, element('summary', {}, 'More light, distance and channels; keys'), panel,
                element('p', {}, 'Drag to look around, click and turn the wheel or pinch for the distance, drag a divider.'), keys));
        this.listen();
    }

    // What is shown or not; one picture at least is.
    toggle(index) {
        const { sides } = this.view, chosen = sides.includes(index) ? sides.filter((side) => side !== index) : [...sides, index].sort((p, q) => p - q);
        if (chosen.length && chosen.length <= SIDES) this.change({ sides: chosen, dividers: [] });
    }

    group(label, buttons) {
        return element('div', { class: 'mv-group', role: 'group', 'aria-label': label }, ...buttons);
    }

    button(label, act, pressed, title = null) {
        const button = element('button', { type: 'button', title }, label);
        button.addEventListener('click', act);
        this.controls[label] = () => button.setAttribute('aria-pressed', pressed());
        return button;
    }

    select(key, label, options) {
        const select = element('select', {}, ...options.map(([value, text]) => element('option', { value }, text)));
        select.addEventListener('change', () => {
            const value = Number(select.value);
            const more = key === 'lights' ? { lightHeight: this.scene.lights[value].height, lightAzimuth: 0 } : {};
            this.change({ [key]: value, ...more });
        });
        this.controls[key] = () => { select.value = this.view[key]; };
        return element('label', { class: `mv-field mv-${key}` }, element('span', {}, label), select);
    }

    slider(key, label, min, max, step, text, toSlider = (x) => x, fromSlider = (x) => x) {
        const input = element('input', { type: 'range', min, max, step });
        const shown = element('span', { class: 'mv-value', 'aria-hidden': 'true' });
        input.addEventListener('input', () => this.change({ [key]: fromSlider(Number(input.value)) }));
        this.controls[key] = () => {
            input.value = toSlider(this.view[key]);
            shown.textContent = text(toSlider(this.view[key]));
            input.setAttribute('aria-valuetext', shown.textContent);
        };
        return element('label', { class: 'mv-field' }, element('span', {}, label, ' ', shown), input);
    }

    // ---- hands and keys

    listen() {
        const fingers = new Map();
        const spread = () => {
            const [p, q] = [...fingers.values()];
            return Math.hypot(p.x - q.x, p.y - q.y);
        };
        this.canvas.addEventListener('pointerdown', (event) => {
            fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
            this.canvas.setPointerCapture(event.pointerId);
        });
        this.canvas.addEventListener('pointermove', (event) => {
            const last = fingers.get(event.pointerId);
            if (!last) return;
            const before = fingers.size === 2 ? spread() : 0;
            const dx = event.clientX - last.x, dy = event.clientY - last.y;
            fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
            if (fingers.size === 2) this.change({ distance: this.view.distance * before / Math.max(spread(), 1) });
            else if (fingers.size === 1) this.orbit(-0.4 * dx, 0.4 * dy);
        });
        for (const end of ['pointerup', 'pointercancel']) {
            this.canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
        }
        this.stage.addEventListener('wheel', (event) => {
            // Until it was clicked, whoever scrolls past wants the rest of the page. Ctrl is how trackpads pinch.
            if (!this.stage.contains(document.activeElement) && !event.ctrlKey) return;
            event.preventDefault();
            const lines = event.deltaMode === 1 ? 30 : event.deltaMode === 2 ? 400 : 1;
            this.change({ distance: this.view.distance * Math.exp(clamp(0.0012 * lines * event.deltaY, -0.5, 0.5)) });
        }, { passive: false });
        this.dividers.forEach((divider, index) => {
            divider.addEventListener('pointerdown', (event) => divider.setPointerCapture(event.pointerId));
            divider.addEventListener('pointermove', (event) => {
                if (!divider.hasPointerCapture(event.pointerId)) return;
                const box = this.stage.getBoundingClientRect();
                this.divide(index, (event.clientX - box.left) / box.width);
            });
            divider.addEventListener('keydown', (event) => {
                const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
                if (!step) return;
                event.preventDefault();
                this.divide(index, this.view.dividers[index] + step);
            });
        });
        this.canvas.addEventListener('keydown', (event) => {
            if (event.ctrlKey || event.metaKey || event.altKey || !this.act(event.key)) return;
            event.preventDefault();
        });
    }

    act(key) {
        const { view } = this;
        const actions = {
            ArrowLeft: () => this.orbit(-3, 0), ArrowRight: () => this.orbit(3, 0),
            ArrowUp: () => this.orbit(0, 2), ArrowDown: () => this.orbit(0, -2),
            '+': () => this.change({ distance: view.distance / 1.1 }), '=': () => this.change({ distance: view.distance / 1.1 }),
            '-': () => this.change({ distance: view.distance * 1.1 }),
            '[': () => this.divide(0, view.dividers[0] - 0.05), ']': () => this.divide(0, view.dividers[0] + 0.05),
            'b': () => this.change({ beside: !view.beside }),
            'd': () => this.change({ differ: !view.differ }), 'l': () => this.change({ lampMoves: !view.lampMoves }),
            ' ': () => this.change({ cameraMoves: !view.cameraMoves }),
        };
        for (const away of Object.keys(AWAY)) actions[away[0]] = () => this.change({ away });
        Object.keys(SHAPES).forEach((shape, i) => { actions[i + 1] = () => this.change({ shape, away: view.away || 'middle' }); });
        if (!(key in actions)) return false;
        actions[key]();
        return true;
    }

    // Whether every side shows the whole picture. Otherwise dividers part one picture, as differences do.
    beside() {
        return this.view.beside && !this.view.differ;
    }

    // Where one side ends and the next begins, as shares of the width.
    lines() {
        return this.beside() ? this.view.dividers.map((_, i, all) => (i + 1) / (all.length + 1)) : this.view.dividers;
    }

    // Dividers that part what is seen evenly: the picture, or the round shape in it.
    even(count) {
        const { width, height } = this.stage.getBoundingClientRect();
        const seen = Math.min(SHAPES[this.view.shape].seen * height / Math.max(width, 1), 1);
        return Array.from({ length: count - 1 }, (_, i) => 0.5 + seen * ((i + 1) / count - 0.5));
    }

    // Moves a divider, and the other one where it is in the way.
    divide(index, to) {
        const at = clamp(to, 0, 1);
        this.change({ dividers: this.view.dividers.map((place, i) => (i === index ? at : i < index ? Math.min(place, at) : Math.max(place, at))) });
    }

    orbit(azimuth, elevation) {
        this.change({ azimuth: this.view.azimuth + azimuth, elevation: this.view.elevation + elevation });
    }

    // ---- drawing

    change(changes = {}) {
        if ('shape' in changes && changes.shape !== this.view.shape && !changes.dividers) this.view.dividers = [];
        const view = Object.assign(this.view, changes), count = view.sides.length;
        if (!changes.away && ['distance', 'tiling'].some((key) => key in changes)) view.away = '';
        if (view.away && ['away', 'shape'].some((key) => key in changes)) this.pose = null;
        view.elevation = clamp(view.elevation, view.shape === 'plane' ? 1 : -60, 90);
        view.distance = clamp(view.distance, view.shape === 'plane' ? 0.5 : 1.5, 32);
        if (view.dividers.length !== count - 1) view.dividers = this.even(count);
        Object.values(this.controls).forEach((update) => update());
        const lines = this.lines();
        this.dividers.forEach((divider, index) => {
            divider.hidden = index >= count - 1;
            divider.classList.toggle('mv-fixed', this.beside());
            divider.tabIndex = this.beside() ? -1 : 0;
            divider.style.left = `${100 * lines[index]}%`;
            divider.setAttribute('aria-valuenow', Math.round(100 * lines[index]));
        });
        const places = [0, ...lines, 1];
        this.names.forEach((name, index) => {
            name.hidden = index >= count;
            if (name.hidden) return;
            const said = this.choices[view.sides[index]].name, last = this.choices[view.sides[count - 1]].name;
            name.textContent = view.differ && index < count - 1 ? `|${said} − ${last}|` : said;
            name.style.setProperty('--mv-from', `${100 * places[index]}%`);
            name.style.setProperty('--mv-width', `${100 * (places[index + 1] - places[index])}%`);
        });
        this.canvas.style.imageRendering = view.pixels > 1 ? 'pixelated' : 'auto';
        if (!Object.keys(changes).length || Object.keys(changes).some((key) => !['gain', 'exposure'].includes(key))) this.gathered = null;
        this.schedule();
    }

    // One frame at a time: a frame may wait for texels, and what changed meanwhile is drawn after it.
    schedule() {
        this.wanted = true;
        if (this.busy || this.broken) return;
        this.busy = true;
        requestAnimationFrame(async (now) => {
            this.wanted = false;
            await this.frame(now).catch((error) => this.fail(error.message));
            this.busy = false;
            if (this.wanted && !this.broken) this.schedule();
            else this.settled?.();
        });
    }

    // Samples of the reference at rest: many lights cost as much as many samples.
    budget() {
        return this.scene.lights[this.view.lights].directions.length > 8 ? 128 : 512;
    }

    // How many samples to draw at a time, so that the page stays responsive on slow devices and fast ones are quick.
    pace(now) {
        const took = this.lastPass ? now - this.lastPass : 60;
        this.each = clamp(took > 120 ? this.each / 2 : took < 40 ? this.each * 2 : this.each, 2, 64);
        this.lastPass = now;
        return this.each;
    }

    background() {
        const [r, g, b] = getComputedStyle(this.stage).backgroundColor.match(/[\d.]+/g).map((x) => Number(x) / 255);
        return [r, g, b];
    }

    // Lamp and camera go on by what has passed since the last frame.
    move(now) {
        const { view } = this, moving = view.lampMoves || view.cameraMoves;
        const passed = moving && this.last ? Math.min((now - this.last) / 1000, 0.1) : 0;
        this.last = moving ? now : null;
        if (view.cameraMoves) view.azimuth += 6 * passed;
        if (view.lampMoves) {
            this.swing = (this.swing ?? 0) + passed;
            view.lightAzimuth = LAMP.degrees * Math.sin(2 * Math.PI * this.swing / LAMP.seconds);
            this.controls.lightAzimuth();
        }
        if (moving) this.gathered = null;
        return moving;
    }

    async frame(now) {
        const { view, renderer, scene } = this, sides = view.sides.map((index) => this.choices[index]);
        if (scene.texels) {
            this.status.textContent = 'Unpacking …';
            await renderer.load();
        }
        const moving = this.move(now), device = Math.min(devicePixelRatio, 2), box = this.stage.getBoundingClientRect();
        const [width, height] = [box.width, box.height].map((x) => Math.max(1, Math.round(x * device / view.pixels)));
        if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
        if (renderer.resize(width, height)) this.gathered = null;
        const columns = this.lines().map((place) => Math.round(place * width)), last = sides.length - 1, beside = this.beside();
        const aspect = (beside ? width / sides.length : width) / height, size = `${height * view.pixels} ${aspect.toFixed(2)}`;
        if (view.away && this.pose !== size) {  // as the reader left it, but for the first time and in a new size
            const { azimuth, elevation, ...rest } = posed(view.shape, view.away, height * view.pixels, aspect, this.choices[0]);
            Object.assign(view, rest, this.pose ? {} : { azimuth, elevation });
            this.pose = size;
            this.gathered = null;
            Object.values(this.controls).forEach((update) => update());
        }
        const fresh = this.gathered === null, budget = this.budget(), reference = sides.includes(scene.source);
        if (fresh) this.gathered = 0;
        const samples = reference ? Math.min(this.pace(now), budget - this.gathered) : 0;
        sides.forEach((stack, side) => {
            const part = view.differ && side === last ? [0, width] : [columns[side - 1] ?? 0, columns[side] ?? width];
            const picture = beside ? part : [0, width];
            if (stack !== scene.source && fresh) renderer.drawSide(side, stack, view, 0, 0, part, picture);
            else if (stack === scene.source && samples) renderer.drawSide(side, stack, view, samples, this.gathered, part, picture);
        });
        this.gathered += samples;
        renderer.present(view, sides.length, columns, this.background());
        const waiting = reference && this.gathered < budget;
        if (!waiting) this.lastPass = null;
        this.status.textContent = !reference ? 'One lookup for each pixel, as engines draw.'
            : moving ? `Truth: the source as it should look. In motion it has ${samples} samples for each pixel: its grain is noise, not shimmer.`
                : `Truth: the source as it should look, the mean of ${this.gathered} samples for each pixel${waiting ? ' …' : '.'}`;
        if (moving || waiting) this.schedule();
    }

    // For scripts: changes the view and resolves when nothing is left to draw. It never does while the shape turns.
    set(changes) {
        return new Promise((resolve) => {
            this.settled = () => { this.settled = null; resolve(); };
            this.change(changes);
        });
    }
}

// What a reader had chosen on a first page (page.js keeps it), once.
function keptView() {
    try {
        const kept = sessionStorage.getItem(location.pathname);
        sessionStorage.removeItem(location.pathname);
        return JSON.parse(kept ?? '{}');
    } catch {
        return {};
    }
}

for (const root of document.querySelectorAll('.mipbake-viewer')) {
    if (root.viewer) continue;
    try {
        root.viewer = new Viewer(root, JSON.parse(root.querySelector('script[type="application/json"]').textContent));
    } catch (error) {
        root.replaceChildren(element('p', { class: 'mv-failure' }, error.message));
    }
}
