// The controls around the renderer, and when to draw: on change, while turning, and while the reference gathers samples.

const SHOWN = ['Shaded', 'Diffuse albedo', 'Reflectance at normal incidence', 'Normal', 'Roughness', 'Level of detail'];
const MODES = { split: 'Side by side', difference: 'Difference', one: 'A alone' };
const KEYS = [
    ['arrows', 'look around'], ['+ −', 'closer, farther'], ['[ ]', 'move the divider'], ['1 2 3', 'plane, sphere, ball'],
    ['s d a', 'side by side, difference, A alone'], ['r', 'the truth in place of B, and back'], ['space', 'turn slowly'],
];

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
        const lights = scene.lights[0];
        this.view = {
            a: 0, b: Math.min(this.choices.length - 1, scene.stacks.length > 1 ? scene.stacks.length - 1 : 1),
            shape: 'plane', mode: 'split', divider: 0.5, gain: 4, exposure: 0, show: 0, tiling: 1, widen: 0, pixels: 1,
            lights: 0, lightAzimuth: 0, lightHeight: lights.height, turning: false,
            ...Viewer.pose('plane'),
        };
        if (this.choices.length === 1) this.view.mode = 'one';
        Object.assign(this.view, keptView());
        this.methodB = this.view.b;
        this.controls = {};
        this.each = 16;
        this.build();
        this.renderer = new Renderer(this.canvas, scene);
        this.canvas.addEventListener('webglcontextlost', () => this.fail('The graphics context was lost: load the page again.'));
        new ResizeObserver(() => this.change()).observe(this.stage);
        matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.change());
        this.change();
    }

    static pose(shape) {
        const { azimuth, elevation, distance } = SHAPES[shape];
        return { azimuth, elevation, distance };
    }

    fail(sentence) {
        this.stage.replaceChildren(element('p', { class: 'mv-failure' }, sentence));
        this.broken = true;
    }

    // ---- what is on the page

    build() {
        this.canvas = element('canvas', {
            tabindex: 0, role: 'img',
            'aria-label': 'A lit surface with the chosen method on either side of the divider; arrow keys look around',
        });
        this.divider = element('div', {
            class: 'mv-divider', role: 'slider', tabindex: 0, 'aria-label': 'Divider between A and B',
            'aria-valuemin': 0, 'aria-valuemax': 100,
        });
        this.nameA = element('span', { class: 'mv-name mv-left' });
        this.nameB = element('span', { class: 'mv-name mv-right' });
        this.stage = element('div', { class: 'mv-stage' }, this.canvas, this.divider, this.nameA, this.nameB);
        this.status = element('p', { class: 'mv-status', role: 'status' });
        const names = this.choices.map((choice) => choice.name);
        const several = names.length > 1;
        const reset = element('button', { type: 'button' }, 'Reset the view');
        reset.addEventListener('click', () => this.change(Viewer.pose(this.view.shape)));
        const top = element('div', { class: 'mv-bar' },
            this.select('shape', 'Shape', Object.entries(SHAPES).map(([key, shape]) => [key, shape.label])),
            this.select('a', 'A', names.map((name, i) => [i, name])),
            ...(several ? [
                this.select('b', 'B', names.map((name, i) => [i, name])),
                this.select('mode', 'Compare', Object.entries(MODES)),
            ] : []),
            this.checkbox('turning', 'Turn slowly'));
        const degrees = (x) => `${Math.round(x)}°`;
        const panel = element('div', { class: 'mv-panel' },
            ...(this.scene.lights.length > 1
                ? [this.select('lights', 'Light', this.scene.lights.map((set, i) => [i, set.name]))] : []),
            this.slider('lightAzimuth', 'Light from', -180, 180, 1, degrees),
            this.slider('lightHeight', 'Light height', -90, 90, 1, degrees),
            this.slider('exposure', 'Exposure', -5, 5, 0.1, (x) => `${x > 0 ? '+' : ''}${x.toFixed(1)} EV`),
            this.slider('widen', 'Added roughness', 0, 0.8, 0.01, (x) => x.toFixed(2)),
            this.slider('distance', 'Distance', -1, 5, 0.01, (x) => (2 ** x).toFixed(2), Math.log2, (x) => 2 ** x),
            this.slider('tiling', 'Texture scale', -3, 3, 0.1, (x) => `×${(2 ** x).toFixed(2)}`, Math.log2, (x) => 2 ** x),
            this.select('pixels', 'Size of a pixel', [[1, 'as the screen'], [2, '×2'], [4, '×4'], [8, '×8']]),
            this.select('show', 'Show', SHOWN.map((name, i) => [i, name])),
            ...(several ? [this.slider('gain', 'Difference gain', 0, 5, 0.1, (x) => `×${(2 ** x).toFixed(1)}`,
                Math.log2, (x) => 2 ** x)] : []),
            reset);
        const keys = element('dl', {}, ...KEYS.flatMap(([key, what]) => [element('dt', {}, key), element('dd', {}, what)]));
        this.root.replaceChildren(top, this.stage, this.status,
            element('details', { class: 'mv-more' }, element('summary', {}, 'Light, distance and what is shown'), panel),
            element('details', { class: 'mv-keys' }, element('summary', {}, 'Keys and gestures'),
                element('p', {}, 'Drag to look around, click and turn the wheel or pinch for the distance, drag the divider.'), keys));
        this.listen();
    }

    select(key, label, options) {
        const select = element('select', {}, ...options.map(([value, text]) => element('option', { value }, text)));
        select.addEventListener('change', () => {
            const value = key === 'shape' || key === 'mode' ? select.value : Number(select.value);
            const more = key === 'shape' ? Viewer.pose(value)
                : key === 'lights' ? { lightHeight: this.scene.lights[value].height, lightAzimuth: 0 } : {};
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

    checkbox(key, label) {
        const input = element('input', { type: 'checkbox' });
        input.addEventListener('change', () => this.change({ [key]: input.checked }));
        this.controls[key] = () => { input.checked = this.view[key]; };
        return element('label', { class: 'mv-check' }, input, label);
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
        this.canvas.addEventListener('wheel', (event) => {
            // Until it was clicked, whoever scrolls past wants the rest of the page. Ctrl is how trackpads pinch.
            if (!this.stage.contains(document.activeElement) && !event.ctrlKey) return;
            event.preventDefault();
            const lines = event.deltaMode === 1 ? 30 : event.deltaMode === 2 ? 400 : 1;
            this.change({ distance: this.view.distance * Math.exp(clamp(0.0012 * lines * event.deltaY, -0.5, 0.5)) });
        }, { passive: false });
        this.divider.addEventListener('pointerdown', (event) => this.divider.setPointerCapture(event.pointerId));
        this.divider.addEventListener('pointermove', (event) => {
            if (!this.divider.hasPointerCapture(event.pointerId)) return;
            const box = this.stage.getBoundingClientRect();
            this.change({ divider: (event.clientX - box.left) / box.width });
        });
        this.divider.addEventListener('keydown', (event) => {
            const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
            if (!step) return;
            event.preventDefault();
            this.change({ divider: this.view.divider + step });
        });
        this.canvas.addEventListener('keydown', (event) => {
            if (event.ctrlKey || event.metaKey || event.altKey || !this.act(event.key)) return;
            event.preventDefault();
        });
    }

    act(key) {
        const { view } = this, shapes = Object.keys(SHAPES), source = this.choices.length - 1;
        const compare = (mode) => this.choices.length > 1 && this.change({ mode });
        const actions = {
            ArrowLeft: () => this.orbit(-3, 0), ArrowRight: () => this.orbit(3, 0),
            ArrowUp: () => this.orbit(0, 2), ArrowDown: () => this.orbit(0, -2),
            '+': () => this.change({ distance: view.distance / 1.1 }), '=': () => this.change({ distance: view.distance / 1.1 }),
            '-': () => this.change({ distance: view.distance * 1.1 }),
            '[': () => this.change({ divider: view.divider - 0.05 }), ']': () => this.change({ divider: view.divider + 0.05 }),
            's': () => compare('split'), 'd': () => compare('difference'), 'a': () => compare('one'),
            'r': () => this.scene.source && this.change({ b: view.b === source ? this.methodB : source }),
            ' ': () => this.change({ turning: !view.turning }),
        };
        shapes.forEach((shape, i) => { actions[i + 1] = () => this.change({ shape, ...Viewer.pose(shape) }); });
        if (!(key in actions)) return false;
        actions[key]();
        return true;
    }

    orbit(azimuth, elevation) {
        this.change({ azimuth: this.view.azimuth + azimuth, elevation: this.view.elevation + elevation });
    }

    // ---- drawing

    change(changes = {}) {
        const view = Object.assign(this.view, changes);
        view.elevation = clamp(view.elevation, view.shape === 'plane' ? 1 : -60, 90);
        view.distance = clamp(view.distance, view.shape === 'plane' ? 0.5 : 1.5, 32);
        view.divider = clamp(view.divider, 0, 1);
        if (this.choices[view.b] !== this.scene.source) this.methodB = view.b;
        Object.values(this.controls).forEach((update) => update());
        const split = view.mode === 'split', percent = Math.round(100 * view.divider);
        this.stage.style.setProperty('--mv-divider', `${100 * view.divider}%`);
        this.divider.hidden = !split;
        this.divider.setAttribute('aria-valuenow', percent);
        this.canvas.style.imageRendering = view.pixels > 1 ? 'pixelated' : 'auto';
        const [a, b] = [this.choices[view.a].name, (this.choices[view.b] ?? this.choices[0]).name];
        this.nameA.textContent = view.mode === 'difference' ? `|${a} − ${b}|` : a;
        this.nameB.textContent = b;
        this.nameB.hidden = !split;
        const composition = ['mode', 'divider', 'gain', 'exposure'];  // these only compose the sides anew
        if (!Object.keys(changes).length || Object.keys(changes).some((key) => !composition.includes(key))) this.gathered = null;
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
        return this.scene.lights[this.view.lights].directions.length > 8 ? 256 : 1024;
    }

    // How many samples to draw at a time, so that the page stays responsive on slow devices and fast ones are quick.
    pace(now) {
        const took = this.lastPass ? now - this.lastPass : 60;
        this.each = clamp(took > 120 ? this.each / 2 : took < 40 ? this.each * 2 : this.each, 8, 64);
        this.lastPass = now;
        return this.each;
    }

    background() {
        const [r, g, b] = getComputedStyle(this.stage).backgroundColor.match(/[\d.]+/g).map((x) => Number(x) / 255);
        return [r, g, b];
    }

    async frame(now) {
        const { view, renderer, scene } = this;
        const sides = [this.choices[view.a], this.choices[view.b] ?? this.choices[0]];
        const needed = view.mode === 'one' ? sides.slice(0, 1) : sides;
        if (scene.texels) {
            this.status.textContent = 'Unpacking …';
            await renderer.load();
        }
        if (view.turning && this.last) this.view.azimuth += 6 * Math.min((now - this.last) / 1000, 0.1);
        this.last = view.turning ? now : null;
        const ratio = Math.min(devicePixelRatio, 2) / view.pixels, box = this.stage.getBoundingClientRect();
        const [width, height] = [box.width, box.height].map((x) => Math.max(1, Math.round(x * ratio)));
        if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
        if (renderer.resize(width, height) || view.turning) this.gathered = null;
        const fresh = this.gathered === null, budget = this.budget(), reference = needed.includes(scene.source);
        if (fresh) this.gathered = 0;
        const samples = reference ? Math.min(this.pace(now), budget - this.gathered) : 0;
        needed.forEach((stack, side) => {
            if (stack !== scene.source && fresh) renderer.drawSide(side, stack, view, 0, 0);
            else if (stack === scene.source && samples) renderer.drawSide(side, stack, view, samples, this.gathered);
        });
        this.gathered += samples;
        renderer.present(view, this.background());
        const waiting = reference && this.gathered < budget;
        if (!waiting) this.lastPass = null;
        if (!reference) this.status.textContent = `One lookup for each pixel${view.mode === 'one' ? '' : ', on both sides'}.`;
        else if (view.turning) this.status.textContent = `While it turns the truth has ${samples} samples for each pixel: its grain is noise, not shimmer.`;
        else if (waiting) this.status.textContent = `Truth: ${this.gathered} of ${budget} samples for each pixel`;
        else if (samples) this.status.textContent = this.verdict(sides, budget);
        if (view.turning || waiting) this.schedule();
    }

    // How far the method is from the reference in this view: 10 log10(sum R^2 / sum (P - R)^2) over the surface.
    verdict(sides, samples) {
        const gathered = `${samples} samples for each pixel of the truth`;
        if (this.view.mode === 'one' || sides[0] === sides[1] || this.view.show !== 0) return `${gathered}.`;
        const reference = sides[0] === this.scene.source ? 0 : 1;
        const r = this.renderer.read(reference), p = this.renderer.read(1 - reference);
        let signal = 0, error = 0;
        for (let i = 0; i < r.length; ++i) {
            if (i % 4 === 3) continue;
            signal += r[i] ** 2;
            error += (p[i] - r[i]) ** 2;
        }
        const decibels = 10 * Math.log10(signal / Math.max(error, 1e-30));
        return `SNR of ${sides[1 - reference].name} in this view: ${decibels.toFixed(1)} dB (${gathered}, their noise counted as error).`;
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
