// The three shapes, generated: {positions, normals, tangents (3 each), uvs (2), indices}, y up, every triangle
// counter-clockwise from outside. u runs along the tangent, v against normal x tangent (down, as in glTF).

function emptyMesh() {
    return { positions: [], normals: [], tangents: [], uvs: [], indices: [] };
}

const normalized = (v) => {
    const length = Math.hypot(...v);
    return v.map((x) => x / length);
};

// Adds a grid of (columns + 1) x (rows + 1) vertices; vertexAt(x, y) gives one for x (along u) and y (along v) in [0, 1].
function addGrid(mesh, columns, rows, vertexAt) {
    const first = mesh.positions.length / 3;
    for (let row = 0; row <= rows; ++row) {
        for (let column = 0; column <= columns; ++column) {
            const vertex = vertexAt(column / columns, row / rows);
            mesh.positions.push(...vertex.position);
            mesh.normals.push(...vertex.normal);
            mesh.tangents.push(...vertex.tangent);
            mesh.uvs.push(...vertex.uv);
        }
    }
    for (let row = 0; row < rows; ++row) {
        for (let column = 0; column < columns; ++column) {
            const a = first + row * (columns + 1) + column, b = a + columns + 1;
            mesh.indices.push(a, b, a + 1, a + 1, b, b + 1);
        }
    }
}

// A floor of 32 x 32 units, one texture across; v comes towards a viewer in front, so that pictures stand upright.
function planeMesh() {
    const mesh = emptyMesh();
    addGrid(mesh, 8, 8, (x, y) => ({
        position: [32 * x - 16, 0, 32 * y - 16], normal: [0, 1, 0], tangent: [1, 0, 0], uv: [x, y],
    }));
    return mesh;
}

// A cube swollen to a sphere, at equal angles: each face carries one texture and none has a pole.
function sphereMesh() {
    const mesh = emptyMesh();
    const faces = [  // outward, along u, against v
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, -1], [-1, 0, 0], [0, 1, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], [[0, 1, 0], [1, 0, 0], [0, 0, -1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    ];
    for (const [out, right, up] of faces) {
        addGrid(mesh, 32, 32, (x, y) => {
            const a = Math.tan((x - 0.5) * Math.PI / 2), b = Math.tan((0.5 - y) * Math.PI / 2);
            const normal = normalized(out.map((o, i) => o + a * right[i] + b * up[i]));
            const along = right.map((r, i) => r - normal[i] * normal.reduce((sum, n, j) => sum + n * right[j], 0));
            return { position: normal, normal, tangent: normalized(along), uv: [x, y] };
        });
    }
    return mesh;
}

// A ball with a recessed ring round its middle, on a flared foot. Its top is mapped as seen from above, so that there
// is no pole; below, the texture goes round six times.
function ballMesh() {
    const mesh = emptyMesh();
    const radians = (degrees) => degrees * Math.PI / 180;
    const perUnit = 6 / (2 * Math.PI);
    const arc = (from, to, radius) => (s) => {
        const latitude = radians(from + (to - from) * s);
        const out = [Math.cos(latitude), Math.sin(latitude)];
        return { at: out.map((x) => radius * x), normal: out };
    };
    const line = (from, to) => (s) => ({
        at: from.map((x, i) => x + (to[i] - x) * s),
        normal: normalized([from[1] - to[1], to[0] - from[0]]),
    });
    const on = (latitude, radius) => arc(latitude, latitude, radius)(0).at;
    const profile = [  // (distance from the axis, height), from the top down
        [arc(45, 12, 1), 24], [line(on(12, 1), on(12, 0.93)), 2], [arc(12, -12, 0.93), 16],
        [line(on(-12, 0.93), on(-12, 1)), 2], [arc(-12, -52, 1), 24],
        [line(on(-52, 1), [0.86, -1.08]), 6], [line([0.86, -1.08], [0.86, -1.16]), 2],
    ];
    let covered = radians(45);  // length along the profile from the top, in units of the radius
    for (const [curve, rows] of profile) {
        const points = Array.from({ length: rows + 1 }, (_, i) => curve(i / rows).at);
        const lengths = [0];
        for (let i = 0; i < rows; ++i) {
            lengths.push(lengths[i] + Math.hypot(points[i + 1][0] - points[i][0], points[i + 1][1] - points[i][1]));
        }
        const start = covered;
        addGrid(mesh, 96, rows, (x, y) => {
            const angle = 2 * Math.PI * (x - 0.5), sin = Math.sin(angle), cos = Math.cos(angle);
            const { at, normal } = curve(y);
            return {
                position: [at[0] * sin, at[1], at[0] * cos],
                normal: [normal[0] * sin, normal[1], normal[0] * cos],
                tangent: [cos, 0, -sin],
                uv: [6 * x, (start + lengths[Math.round(y * rows)]) * perUnit],
            };
        });
        covered += lengths[rows];
    }
    addGrid(mesh, 32, 32, (x, y) => {
        // A square swollen to a disc (concentric rings), then the disc laid over the ball at true distance from its top.
        const p = 2 * x - 1, q = 2 * y - 1, ring = Math.max(Math.abs(p), Math.abs(q)), length = Math.hypot(p, q) || 1;
        const angle = ring * radians(45), s = p / length, c = q / length;
        const sinc = angle > 1e-6 ? Math.sin(angle) / angle : 1;
        const down = [Math.cos(angle) * s, -Math.sin(angle), Math.cos(angle) * c], round = [c, 0, -s];
        const position = [Math.sin(angle) * s, Math.cos(angle), Math.sin(angle) * c];
        return {
            position, normal: position,
            tangent: ring > 0 ? normalized(down.map((d, i) => s * d + sinc * c * round[i])) : [1, 0, 0],
            uv: [angle * s * perUnit, angle * c * perUnit],
        };
    });
    return mesh;
}

// `tiles`: how often the texture repeats along a unit of uv, to begin with; `span`: the units of uv round or across the
// shape; `perUnit`: units of uv along a unit of length in the middle of the picture; `front`: how far in front of the
// target the surface lies there; `seen`: its width, in heights of the picture; the rest is how it is seen at first, in
// degrees and units of length.
const SHAPES = {
    plane: {
        label: 'Floor', mesh: planeMesh, tiles: 16, span: 1, perUnit: 1 / 32, front: 0, seen: Infinity,
        target: [0, 0, 0], azimuth: 0, elevation: 30, distance: 5,
    },
    sphere: {
        label: 'Sphere', mesh: sphereMesh, tiles: 2, span: 1, perUnit: 2 / Math.PI, front: 1, seen: 0.85,
        target: [0, 0, 0], azimuth: 25, elevation: 18, distance: 3.4,
    },
    ball: {
        label: 'Ball', mesh: ballMesh, tiles: 1, span: 6, perUnit: 3 / Math.PI, front: 1, seen: 0.64,
        target: [0, -0.16, 0], azimuth: 20, elevation: 18, distance: 4.4,
    },
};

// Level of detail in the middle of the picture. A floor is looked at from above when it is near, and along it when far.
const AWAY = {
    near: { label: 'Near', lod: -0.3, elevation: 40, title: 'texels about as large as pixels, or larger: levels of detail below 1' },
    middle: { label: 'Middle distance', lod: 1.8, elevation: 30, title: 'two to eight texels across a pixel: levels of detail 1 to 3' },
    far: { label: 'Far', lod: 4, elevation: 22, title: 'eight texels and more across a pixel: levels of detail 3 and more' },
};

// How a shape is seen near, at middle distance or far, in a picture of so many rows: textures that repeat are scaled,
// others are moved away from. A round shape fits into the picture's width.
function posed(shape, away, rows, aspect, stack) {
    const { perUnit, tiles, span, front, seen, azimuth } = SHAPES[shape], flat = shape === 'plane';
    const { lod, elevation: above } = AWAY[away], elevation = flat ? above : SHAPES[shape].elevation;
    const distance = SHAPES[shape].distance * (flat ? 1 : Math.max(1, 1.08 * seen / aspect));
    const slant = flat ? Math.sin(elevation * Math.PI / 180) : 1, pixel = 2 * Math.tan(FIELD_OF_VIEW / 2) / rows;
    const texels = 2 ** lod * slant / pixel;  // across what lies at unit distance, were it one unit of uv
    if (stack.wrap[0] === 'wrap') return { azimuth, elevation, distance, tiling: texels / ((distance - front) * perUnit * tiles * stack.sizes[0][1]) };
    return { azimuth, elevation, distance: front + texels / (perUnit / span * stack.sizes[0][1]), tiling: 1 };
}
