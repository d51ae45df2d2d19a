import { CanvasTexture, Mesh, MeshBasicMaterial, PlaneGeometry, SRGBColorSpace } from "three";

/** Draws overlays after the scene; nearer objects hide them. */
export const OVERLAY_ORDER = 10;

/** A rectangle in VR with a canvas texture, initially hidden. */
export class CanvasPlane {
  readonly mesh: Mesh<PlaneGeometry, MeshBasicMaterial>;
  readonly texture: CanvasTexture;
  private readonly context: CanvasRenderingContext2D;

  /** Size in pixels, and width in metres. */
  constructor(width: number, height: number, widthM: number) {
    const canvas = document.createElement("canvas");
    canvas.width = width;
    canvas.height = height;
    this.context = canvas.getContext("2d")!;
    this.texture = new CanvasTexture(canvas);
    this.texture.colorSpace = SRGBColorSpace;
    const material = new MeshBasicMaterial({ map: this.texture, transparent: true, depthWrite: false, toneMapped: false });
    this.mesh = new Mesh(new PlaneGeometry(widthM, (widthM * height) / width), material);
    this.mesh.renderOrder = OVERLAY_ORDER;
    this.mesh.visible = false;
  }

  dispose(): void {
    this.texture.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }

  paint(paint: (context: CanvasRenderingContext2D) => void): void {
    paint(this.context);
    this.texture.needsUpdate = true;
  }
}
