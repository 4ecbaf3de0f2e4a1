// Renders views in three.js into float targets: sums of renders at sub-pixel offsets, and levels of textures as they are sampled.
import * as THREE from 'three';
import { RoomEnvironment } from 'three/addons/environments/RoomEnvironment.js';
import { loadTexture, startLoading } from './textures.js';
import { sumOf } from './targets.js';
import { textOf } from '../pixels.js';

const SAMPLES_A_SUM = 64; // float32 sums stay short, float64 sums collect them

const renderer = new THREE.WebGLRenderer({ antialias: false });
renderer.autoClear = false;
renderer.setClearColor(0x000000, 0);
const gl = renderer.getContext();
for (const name of ['EXT_color_buffer_float', 'EXT_float_blend', 'OES_texture_float_linear']) {
  if (!gl.getExtension(name)) throw new Error(`WebGL lacks ${name}`);
}
startLoading(renderer);

const scene = new THREE.Scene();
const key = new THREE.DirectionalLight(0xffffff, 3);
key.position.set(-0.5, 0.7, 0.6);
scene.add(key);
const pmrem = new THREE.PMREMGenerator(renderer);
const room = new RoomEnvironment();
scene.environment = pmrem.fromScene(room, 0.04).texture;
room.dispose();

const materials = new Map();
const views = new Map();
let mesh = null;

function light(intensity) {
  key.intensity = intensity;
}

function describe() {
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return {
    three: THREE.REVISION,
    renderer: gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER),
    bc7: gl.getExtension('EXT_texture_compression_bptc') !== null,
  };
}

async function addMaterial(name, maps, filter) {
  const [map, normalMap, orm] = await Promise.all(
    ['base_color', 'normal', 'orm'].map((role) => loadTexture(maps[role], filter)));
  const material = new THREE.MeshPhysicalMaterial({
    map, normalMap, roughnessMap: orm, metalnessMap: orm, roughness: 1, metalness: 1,
    blending: THREE.AdditiveBlending, depthTest: false, depthWrite: false, // views are convex: nothing hides anything
  });
  materials.set(name, material);
}

async function addView(name, file) {
  const view = await (await fetch(`/files/${file}`)).json();
  const geometry = new THREE.BufferGeometry();
  const attribute = (values, size) => new THREE.BufferAttribute(new Float32Array(values), size);
  geometry.setAttribute('position', attribute(view.positions, 3));
  geometry.setAttribute('normal', attribute(view.normals, 3));
  geometry.setAttribute('uv', attribute(view.uv, 2));
  geometry.setAttribute('tangent', attribute(view.tangents, 4));
  geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(view.triangles), 1));
  const camera = new THREE.PerspectiveCamera(view.fieldOfView, view.width / view.height, view.near, view.far);
  camera.position.set(...view.position);
  camera.up.set(...view.up);
  camera.lookAt(...view.target);
  views.set(name, { geometry, camera, width: view.width, height: view.height });
}

// Sum of the renders at `offsets`, flat pairs of pixels to the right and down: RGBA, A the samples that met the surface; bottom row first.
function render(viewName, materialName, offsets) {
  const view = views.get(viewName);
  if (mesh) scene.remove(mesh);
  mesh = new THREE.Mesh(view.geometry, materials.get(materialName));
  mesh.frustumCulled = false;
  scene.add(mesh);
  const { width, height, camera } = view;
  const draws = [];
  for (let i = 0; i < offsets.length; i += 2) {
    draws.push(() => {
      camera.setViewOffset(width, height, offsets[i], offsets[i + 1], width, height);
      renderer.render(scene, camera);
    });
  }
  return textOf(sumOf(renderer, width, height, draws, SAMPLES_A_SUM));
}

// The texture on a square that faces the camera: `repeat` times along u and v over `side` pixels, unlit.
async function flat(map, filter, side, repeats) {
  const texture = await loadTexture(map, filter);
  const found = repeats.map(([u, v]) => flatOnce(texture, side, u, v));
  texture.dispose();
  return found;
}

function flatOnce(texture, side, u, v) {
  const geometry = new THREE.PlaneGeometry(2, 2);
  geometry.setAttribute('uv', new THREE.BufferAttribute(new Float32Array([0, 0, u, 0, 0, v, u, v]), 2)); // top row first
  const material = new THREE.MeshBasicMaterial({ map: texture });
  const square = new THREE.Scene();
  square.add(new THREE.Mesh(geometry, material));
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1);
  const text = textOf(sumOf(renderer, side, side, [() => renderer.render(square, camera)], 1));
  geometry.dispose();
  material.dispose();
  return text;
}

window.proof = { describe, light, addMaterial, addView, render, flat };
