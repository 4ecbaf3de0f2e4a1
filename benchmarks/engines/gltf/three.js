// A GLB through three.js's GLTFLoader and KTX2Loader, seen straight on by an orthographic camera.
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';
import { textOf } from '../pixels.js';

async function render(file, box, width, height) {
  const renderer = new THREE.WebGLRenderer({ antialias: false });
  const textures = new KTX2Loader()
    .setTranscoderPath('/engines/node_modules/three/examples/jsm/libs/basis/')
    .detectSupport(renderer);
  const asset = await new GLTFLoader().setKTX2Loader(textures).loadAsync(`/files/${file}`);
  const scene = new THREE.Scene();
  scene.add(asset.scene);
  const light = new THREE.DirectionalLight(0xffffff, 3);
  light.position.set(0.3, 0.4, 1);
  scene.add(light, new THREE.AmbientLight(0xffffff, 0.3));
  const [left, right, bottom, top] = box;
  const camera = new THREE.OrthographicCamera(left, right, top, bottom, 0.1, 100);
  camera.position.set(0, 0, 10);
  const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(width * height * 4);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  const found = new Map();
  asset.scene.traverse((node) => {
    for (const texture of Object.values(node.material ?? {})) {
      if (texture?.isTexture) found.set(texture.uuid, texture.mipmaps.length);
    }
  });
  return { pixels: textOf(Float64Array.from(pixels)), levels: [...found.values()] };
}

window.proof = { render, version: `three.js r${THREE.REVISION}` };
