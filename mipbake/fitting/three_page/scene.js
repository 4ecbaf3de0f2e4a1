// A mesh under directional lights, drawn by three.js into a float target; and where its pixels look textures up.
import * as THREE from 'three';

// What the material has beside the maps. The numbers are guesses at what looks like lacquer and like cloth.
const MATERIALS = {
  standard: {},
  physical: { clearcoat: 1, clearcoatRoughness: 0.1, iridescence: 1, iridescenceIOR: 1.4 },
  cloth: { sheen: 1, sheenRoughness: 0.4, sheenColor: new THREE.Color(0.6, 0.5, 0.4) },
};
const WRAPS = { wrap: THREE.RepeatWrapping, clamp: THREE.ClampToEdgeWrapping };

const canvas = document.createElement('canvas');
document.body.append(canvas);
const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
renderer.autoClear = false;
renderer.setClearColor(0x000000, 0);
renderer.debug.onShaderError = (gl, program, vertex, fragment) => {
  const logs = [gl.getProgramInfoLog(program), gl.getShaderInfoLog(vertex), gl.getShaderInfoLog(fragment)];
  throw new Error(`a shader does not compile: ${logs.filter((log) => log && log.trim()).join(' ')}`);
};
const gl = renderer.getContext();
if (!gl.getExtension('EXT_color_buffer_float')) throw new Error('WebGL lacks EXT_color_buffer_float');

const camera = new THREE.Camera();
camera.matrixAutoUpdate = false;
const mesh = new THREE.Mesh();
mesh.frustumCulled = false;
const lit = new THREE.Scene();
const bare = new THREE.Scene(); // without lights
const geometries = new Map(); // by their numbers
let set = null; // textures with a material
const lights = [];
const at = new THREE.Vector2();
let target = null;

const where = new THREE.ShaderMaterial({
  glslVersion: THREE.GLSL3,
  side: THREE.DoubleSide,
  uniforms: { levels: { value: null } },
  vertexShader: `
    out vec2 at;
    void main() {
      at = uv;
      vec4 inEye = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * inEye;
    }`,
  // Each level of levels holds its own number, so a lookup gives the level of detail that the GPU takes.
  fragmentShader: `
    uniform sampler2D levels;
    in vec2 at;
    out vec4 found;
    void main() {
      found = vec4(at, texture(levels, at).r, 1.0);
    }`,
});

// RGBA of the picture, A 1 where the mesh is; and when it is asked for, u, v, level of detail, 1. Bottom row first.
export function frame(header, arrays) {
  arrange(header, arrays);
  const found = [drawn(lit, set.material, header)];
  if (header.where) {
    where.uniforms.levels.value = set.numbers;
    found.push(drawn(bare, where, header));
  }
  return found;
}

// Lays out what a job names: mesh, lights, textures.
function arrange(header, arrays) {
  if (arrays.position) geometries.set(header.mesh, geometryOf(arrays));
  mesh.geometry = geometries.get(header.mesh);
  if (header.fresh) {
    if (set) [...Object.values(set.textures), set.numbers, set.material].forEach((each) => each.dispose());
    set = setOf(header);
  }
  header.changed.forEach(([level, row, column, height, width], index) => {
    at.set(column, row);
    for (const role of header.roles) {
      const part = new THREE.DataTexture(arrays[`${role} ${index}`], width, height);
      renderer.copyTextureToTexture(part, set.textures[role], null, at, 0, level);
    }
  });
  shine(header.lights);
}

function geometryOf({ position, normal, uv, tangent, index }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(position, 3));
  geometry.setAttribute('normal', new THREE.BufferAttribute(normal, 3));
  geometry.setAttribute('uv', new THREE.BufferAttribute(uv, 2));
  geometry.setAttribute('tangent', new THREE.BufferAttribute(tangent, 4));
  geometry.setIndex(new THREE.BufferAttribute(index, 1));
  return geometry;
}

// three.js multiplies a light's colour by the cosine and by a BRDF that divides by pi, so a colour is an irradiance.
function shine(wanted) {
  while (lights.length > wanted.length) lit.remove(lights.pop());
  while (lights.length < wanted.length) {
    lights.push(new THREE.DirectionalLight());
    lit.add(lights.at(-1)); // its target stays at the origin
  }
  wanted.forEach(([x, y, z, ...irradiance], index) => {
    lights[index].position.set(x, y, z);
    lights[index].color.setRGB(...irradiance);
  });
}

function setOf({ roles, sizes, wrap, material }) {
  const four = { format: THREE.RGBAFormat, type: THREE.UnsignedByteType };
  const one = { format: THREE.RedFormat, type: THREE.HalfFloatType };
  const textures = Object.fromEntries(roles.map((role) => [role, textureOf(sizes, wrap, four)]));
  // Their texels come in parts, straight to the GPU: there is room for them, and nothing here.
  Object.values(textures).forEach((texture) => { texture.source.dataReady = false; });
  const numbers = textureOf(sizes, wrap, one);
  levelsOf(numbers).forEach((level, number) => {
    level.data = new Uint16Array(level.width * level.height).fill(THREE.DataUtils.toHalfFloat(number));
  });
  Object.values(textures).concat(numbers).forEach((texture) => { texture.needsUpdate = true; });
  textures.base_color.colorSpace = THREE.SRGBColorSpace;
  const made = new THREE.MeshPhysicalMaterial({
    ...MATERIALS[material], map: textures.base_color, normalMap: textures.normal,
    roughnessMap: textures.orm, metalnessMap: textures.orm, roughness: 1, metalness: 1, side: THREE.DoubleSide,
    ...(textures.anisotropy ? { anisotropy: 1, anisotropyMap: textures.anisotropy } : {}),
  });
  return { textures, numbers, material: made };
}

// Without texels.
function textureOf(sizes, wrap, { format, type }) {
  const levels = sizes.map(([height, width]) => ({ data: null, width, height }));
  const [{ width, height }] = levels;
  const texture = new THREE.DataTexture(null, width, height, format, type);
  if (levels.length > 1) texture.mipmaps = levels;
  texture.wrapS = WRAPS[wrap[0]];
  texture.wrapT = WRAPS[wrap[1]];
  texture.magFilter = THREE.LinearFilter;
  texture.minFilter = levels.length > 1 ? THREE.LinearMipmapLinearFilter : THREE.LinearFilter;
  texture.generateMipmaps = false;
  return texture;
}

function levelsOf(texture) {
  return texture.mipmaps.length > 0 ? texture.mipmaps : [texture.image];
}

// Float32Array of RGBA, bottom row first.
function drawn(scene, material, { view, projection, size }) {
  target = sized(target, size);
  camera.matrix.fromArray(view).invert();
  camera.projectionMatrix.fromArray(projection);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  camera.updateMatrixWorld(true);
  mesh.material = material;
  scene.add(mesh);
  renderer.setRenderTarget(target);
  renderer.clear();
  renderer.render(scene, camera);
  const found = new Float32Array(4 * target.width * target.height);
  renderer.readRenderTargetPixels(target, 0, 0, target.width, target.height, found);
  if (gl.isContextLost()) throw new Error('the WebGL context was lost');
  const wrong = gl.getError();
  if (wrong !== gl.NO_ERROR) throw new Error(`WebGL says error ${wrong}`);
  return found;
}

// A float target of a size: the one that is given, where it has that size. What another one holds goes.
function sized(old, [height, width]) {
  if (old && old.width === width && old.height === height) return old;
  old?.dispose();
  const nearest = { minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };
  return new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType, ...nearest });
}
