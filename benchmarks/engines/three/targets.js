// Sums of draws in float targets, read back.
import * as THREE from 'three';

const targets = new Map();

function targetOf(width, height) {
  const key = `${width} ${height}`;
  if (!targets.has(key)) {
    targets.set(key, new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType, depthBuffer: false }));
  }
  return targets.get(key);
}

// Float64Array of RGBA, bottom row first: the target is read and cleared after every `each` draws.
export function sumOf(renderer, width, height, draws, each) {
  const target = targetOf(width, height);
  const sum = new Float64Array(width * height * 4);
  const part = new Float32Array(sum.length);
  renderer.setRenderTarget(target);
  for (let start = 0; start < draws.length; start += each) {
    renderer.clear();
    for (const draw of draws.slice(start, start + each)) draw();
    renderer.readRenderTargetPixels(target, 0, 0, width, height, part);
    for (let i = 0; i < sum.length; i++) sum[i] += part[i];
  }
  renderer.setRenderTarget(null);
  return sum;
}
