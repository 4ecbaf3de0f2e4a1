// A GLB through Filament's gltfio, seen straight on by an orthographic camera.
import { textOf } from '../pixels.js';

const MOST_FRAMES = 600;
const SAME_FRAMES = 20;
const MILLISECONDS = 50;

async function render(file, box, width, height) {
  const { Filament } = window; // its script replaces the factory by the module
  const data = new Uint8Array(await (await fetch(`/files/${file}`)).arrayBuffer());
  const canvas = document.querySelector('canvas');
  canvas.width = width;
  canvas.height = height;
  const engine = Filament.Engine.create(canvas);
  const scene = engine.createScene();
  const swapChain = engine.createSwapChain();
  const renderer = engine.createRenderer();
  const camera = engine.createCamera(Filament.EntityManager.get().create());
  const view = engine.createView();
  view.setCamera(camera);
  view.setScene(scene);
  view.setViewport([0, 0, width, height]);
  view.setPostProcessingEnabled(false); // no tone mapping, dithering or antialiasing after the shader
  const [left, right, bottom, top] = box;
  camera.setProjection(Filament.Camera$Projection.ORTHO, left, right, bottom, top, 0.1, 100);
  camera.lookAt([0, 0, 10], [0, 0, 0], [0, 1, 0]);
  camera.setExposureDirect(1);
  const sun = Filament.EntityManager.get().create();
  Filament.LightManager.Builder(Filament.LightManager$Type.DIRECTIONAL)
    .color([1, 1, 1]).intensity(3).direction([-0.3, -0.4, -1]).build(engine, sun);
  scene.addEntity(sun);
  renderer.setClearOptions({ clearColor: [0, 0, 0, 0], clear: true });

  const loader = engine.createAssetLoader();
  const asset = loader.createAsset(data);
  if (!asset) throw new Error('Filament takes no such asset');
  await new Promise((resolve) => asset.loadResources(resolve, null, null, null));
  scene.addEntities(asset.getEntities());
  const gl = window.filament_glContext ?? canvas.getContext('webgl2');
  const pixels = new Uint8Array(width * height * 4);
  const shown = () => {
    renderer.render(swapChain, view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels.reduce((hash, value) => (Math.imul(hash, 31) + value) | 0, 0);
  };
  // Shaders are compiled while frames go by: the picture is what stays.
  const empty = pixels.reduce((hash) => Math.imul(hash, 31) | 0, 0);
  let last = empty;
  for (let frame = 0, same = 0; frame < MOST_FRAMES && same < SAME_FRAMES; frame++) {
    await new Promise((resolve) => setTimeout(resolve, MILLISECONDS));
    const now = shown();
    same = now === last && now !== empty ? same + 1 : 0;
    last = now;
  }
  return { pixels: textOf(Float64Array.from(pixels, (value) => value / 255)), levels: [] };
}

window.Filament.init([], () => { window.proof = { render, version: 'Filament' }; });
