import {
  BoxGeometry,
  CanvasTexture,
  DirectionalLight,
  Group,
  HemisphereLight,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  PlaneGeometry,
  RepeatWrapping,
  SRGBColorSpace,
  type BufferGeometry,
  type Material,
  type Object3D,
  type Texture,
} from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import { seededRandom } from "./random";
import type { Detail } from "./view";

/** The room in the world frame: z up, centred at the origin, metres. */
const SIZE = 6;
const HEIGHT = 2.7;
const HALF = SIZE / 2;
const WINDOW = { bottom: 0.95, width: 1.8, height: 1.35 };
const LEFT_WINDOW_Y = 1.45;
const FRONT_WINDOW_X = 1.35;

const WOODWORK = new MeshStandardMaterial({ color: 0xfcfbf8, roughness: 0.55 });
const PLANKS = { tileM: 2, across: 10, pixels: 1024 };

export function createRoom({ anisotropy, lighting }: Detail): Group {
  const built = new Group();
  built.add(floor(anisotropy), ceiling(), ...walls(), ...skirting(), ...windows());
  const room = joinedByMaterial(built);
  room.add(skyLight(lighting ? 1.15 : 2.7), sunLight(lighting));
  return room;
}

/** Merges the meshes of each material into one, for few draw calls. They only receive shadows. */
function joinedByMaterial(built: Group): Group {
  const pieces = new Map<Material, BufferGeometry[]>();
  built.updateMatrixWorld();
  built.traverse((node) => {
    if (isMesh(node)) pieces.set(node.material, [...(pieces.get(node.material) ?? []), placed(node)]);
  });
  const joined = new Group();
  for (const [material, geometries] of pieces) {
    const mesh = new Mesh(mergeGeometries(geometries), material);
    mesh.receiveShadow = true;
    joined.add(mesh);
  }
  return joined;
}

function placed({ geometry, matrixWorld }: Mesh): BufferGeometry {
  return geometry.clone().applyMatrix4(matrixWorld);
}

function isMesh(node: Object3D): node is Mesh<BufferGeometry, Material> {
  return node instanceof Mesh;
}

function floor(anisotropy: number): Mesh {
  const map = plankTexture();
  map.anisotropy = anisotropy;
  return new Mesh(new PlaneGeometry(SIZE, SIZE), new MeshStandardMaterial({ map, roughness: 0.62 }));
}

function ceiling(): Mesh {
  const mesh = new Mesh(
    new PlaneGeometry(SIZE, SIZE),
    new MeshStandardMaterial({ color: 0xf6f4ef, roughness: 1 }),
  );
  mesh.position.z = HEIGHT;
  mesh.rotation.x = Math.PI;
  return mesh;
}

/** Four walls that face inwards. */
function walls(): Group[] {
  const material = new MeshStandardMaterial({ color: 0xe6e4dc, roughness: 0.95 });
  return quarters(() => {
    const wall = new Mesh(new PlaneGeometry(SIZE, HEIGHT), material);
    wall.rotation.x = Math.PI / 2;
    wall.position.set(0, HALF, HEIGHT / 2);
    return wall;
  });
}

function skirting(): Group[] {
  return quarters(() => {
    const board = new Mesh(new BoxGeometry(SIZE, 0.016, 0.09), WOODWORK);
    board.position.set(0, HALF - 0.008, 0.045);
    return board;
  });
}

function quarters(make: () => Mesh): Group[] {
  return [0, 1, 2, 3].map((quarter) => {
    const side = new Group();
    side.rotation.z = (quarter * Math.PI) / 2;
    side.add(make());
    return side;
  });
}

/** Windows on the person's left and in front, from which the sun shines. */
function windows(): Group[] {
  const sky = new MeshBasicMaterial({ map: skyTexture() });
  const onLeft = makeWindow(sky);
  onLeft.position.set(HALF - 0.005, LEFT_WINDOW_Y, WINDOW.bottom + WINDOW.height / 2);
  onLeft.rotation.set(Math.PI / 2, -Math.PI / 2, 0);
  const inFront = makeWindow(sky);
  inFront.position.set(FRONT_WINDOW_X, -HALF + 0.005, WINDOW.bottom + WINDOW.height / 2);
  inFront.rotation.set(Math.PI / 2, Math.PI, 0);
  return [onLeft, inFront];
}

/** A window in its own frame: x along the wall, y up, z into the room. */
function makeWindow(sky: Material): Group {
  const { width, height } = WINDOW;
  return new Group().add(new Mesh(new PlaneGeometry(width, height), sky), ...windowFrame(width, height));
}

function windowFrame(width: number, height: number): Mesh[] {
  const bar = 0.06;
  const [x, y] = [width / 2, height / 2];
  return [
    box( width + bar, bar, 0.05, 0, y),
    box( width + 0.24, 0.035, 0.22, 0, -y),
    box( bar, height, 0.05, -x, 0),
    box( bar, height, 0.05, x, 0),
    box( bar * 0.8, height, 0.04, 0, 0),
  ];
}

function box(width: number, height: number, depth: number, x: number, y: number): Mesh {
  const mesh = new Mesh(new BoxGeometry(width, height, depth), WOODWORK);
  mesh.position.set(x, y, depth / 2);
  return mesh;
}

/** three.js's hemisphere light points along y; in the room up is z. */
function skyLight(intensity: number): HemisphereLight {
  const light = new HemisphereLight(0xf6f9ff, 0xe6ded2, intensity);
  light.position.set(0, 0, 1);
  return light;
}

/** Side length of the shadow map in pixels of 2.4 mm. */
const SHADOW_PIXELS = 1408;

function sunLight(castShadow: boolean): Group {
  const light = new DirectionalLight(0xfff3e2, 2.5);
  light.position.set(1.7, -1.9, 2.6);
  light.target.position.set(0, 0, 0.5);
  light.castShadow = castShadow;
  light.shadow.mapSize.set(SHADOW_PIXELS, SHADOW_PIXELS);
  light.shadow.radius = 1; // three samples a larger one with noise, which is grain near the eyes
  light.shadow.normalBias = 0.02;
  light.shadow.bias = -0.0004;
  Object.assign(light.shadow.camera, { left: -1.7, right: 1.7, top: 1.7, bottom: -1.7, near: 0.2, far: 6 });
  return new Group().add(light, light.target);
}

function canvas2d(width: number, height: number): CanvasRenderingContext2D {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  return canvas.getContext("2d")!;
}

function textureOf(context: CanvasRenderingContext2D): Texture {
  const texture = new CanvasTexture(context.canvas);
  texture.colorSpace = SRGBColorSpace;
  return texture;
}

function skyTexture(): Texture {
  const context = canvas2d(4, 128);
  const gradient = context.createLinearGradient(0, 0, 0, 128);
  gradient.addColorStop(0, "#a9c9e8");
  gradient.addColorStop(0.7, "#e4eef5");
  gradient.addColorStop(1, "#f3f1e8");
  context.fillStyle = gradient;
  context.fillRect(0, 0, 4, 128);
  return textureOf(context);
}

/** A texture of oak planks with staggered boards. */
function plankTexture(): Texture {
  const { pixels, across, tileM } = PLANKS;
  const context = canvas2d(pixels, pixels);
  const random = seededRandom(7);
  const width = pixels / across;
  for (let row = 0; row < across; row++) paintRow(context, random, row * width, width);
  const texture = textureOf(context);
  texture.wrapS = texture.wrapT = RepeatWrapping;
  texture.repeat.set(SIZE / tileM, SIZE / tileM);
  return texture;
}

/** Two staggered boards, drawn twice for a seamless texture. */
function paintRow(context: CanvasRenderingContext2D, random: () => number, x: number, width: number): void {
  const { pixels } = PLANKS;
  const offset = random() * pixels;
  for (let board = 0; board < 2; board++) {
    const tone = 0.93 + 0.14 * random();
    const seed = Math.floor(random() * 1e9);
    const y = (offset + (board * pixels) / 2) % pixels;
    for (const top of [y, y - pixels])
      paintBoard(context, seededRandom(seed), x, top, width, pixels / 2, tone);
  }
}

function paintBoard(
  context: CanvasRenderingContext2D,
  random: () => number,
  x: number,
  y: number,
  width: number,
  length: number,
  tone: number,
): void {
  context.fillStyle = `rgb(${196 * tone}, ${163 * tone}, ${124 * tone})`;
  context.fillRect(x, y, width, length);
  for (let grain = 0; grain < 26; grain++) {
    context.fillStyle = `rgba(110, 78, 46, ${0.02 + 0.07 * random()})`;
    context.fillRect(x + random() * width, y, 0.6 + 1.6 * random(), length);
  }
  context.fillStyle = "rgba(84, 60, 38, 0.55)";
  context.fillRect(x, y, 1.4, length);
  context.fillRect(x, y, width, 1.4);
}
