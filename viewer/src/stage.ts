// The scene in 3D: meshes that show the light map, markers for lights, camera, picking, gizmo.

import {
  AgXToneMapping, Box3, BufferAttribute, BufferGeometry, Color, Group, Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial,
  Object3D, PerspectiveCamera, Raycaster, Scene as ThreeScene, ShaderMaterial, SphereGeometry, Vector2, Vector3,
  WebGLRenderer,
} from 'three';
import type { Camera, Light, Point, Scene, SceneObject } from 'rebake';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { TransformControls } from 'three/examples/jsm/controls/TransformControls.js';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import type { LightMap } from './lightmap';
import { shared, surface } from './material';
import { rise } from './rays';
import type { View } from './api';

export interface Picked {
  kind: 'object' | 'light';
  name: string;
}

export class Stage {
  /** Something was clicked, or nothing. */
  onPick: (picked: Picked | null) => void = () => {};
  /** The gizmo was let go: by which world-space matrix the selected moved. */
  onMoved: (picked: Picked, delta: Matrix4) => void = () => {};
  /** The camera came to rest. */
  onCamera: () => void = () => {};
  /** Milliseconds from frame to frame, when something moved last. */
  frameMs = 0;
  split = false;

  private readonly renderer: WebGLRenderer;
  private readonly scene = new ThreeScene();
  private readonly camera = new PerspectiveCamera(60, 1, 0.01, 1000);
  private readonly orbit: OrbitControls;
  private readonly gizmo: TransformControls;
  private readonly pivot = new Object3D();
  private readonly objects = new Map<string, Group>();
  /** What stood where before the last edit, with its light of then; null where that is what stands there now. */
  private past: Group[] | null = null;
  private readonly markers = new Map<string, Mesh>();
  private selected: Picked | null = null;
  private dirty = true;
  private pivotStart = new Matrix4();

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true });
    this.renderer.toneMapping = AgXToneMapping;
    this.renderer.autoClear = false;
    this.scene.background = new Color(0x08090b);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener('change', () => this.invalidate());
    this.orbit.addEventListener('end', () => this.onCamera());
    this.gizmo = new TransformControls(this.camera, canvas);
    this.gizmo.setSize(0.8);
    this.gizmo.addEventListener('change', () => this.invalidate());
    this.gizmo.addEventListener('objectChange', () => this.dragged());
    this.gizmo.addEventListener('dragging-changed', (event) => this.dragging(event.value as boolean));
    this.scene.add(this.pivot, this.gizmo.getHelper());
    this.watchClicks();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement!);
    this.resize();
    let last = 0;
    const frame = (now: number) => {
      requestAnimationFrame(frame);
      if (!this.dirty) {
        last = 0;
        return;
      }
      // From frame to frame while something moves: what the graphics card takes is in it.
      if (last) this.frameMs = now - last;
      last = now;
      this.draw();
    };
    requestAnimationFrame(frame);
  }

  invalidate(): void {
    this.dirty = true;
  }

  set exposure(stops: number) {
    this.renderer.toneMappingExposure = 2 ** stops;
    this.invalidate();
  }

  /** An edit is about to change the scene: what is there now is what the split view shows on its left. */
  remember(): void {
    this.dispose(this.past ?? []);
    this.past = null;
  }

  /** Shows nothing. */
  clear(): void {
    this.select(null);
    this.remember();
    this.dispose(this.objects.values());
    this.objects.clear();
    this.mark([], []);
    this.invalidate();
  }

  /** Shows the meshes of a light map file. Nodes carry the objects' names, vertices are elements in order. */
  async show(file: ArrayBuffer, scene: Scene, map: LightMap): Promise<void> {
    const gltf = await new GLTFLoader().parseAsync(file, '');
    map.grow(scene.elements);
    map.release();
    if (this.past || this.objects.size === 0) this.dispose(this.objects.values());
    else this.past = [...this.objects.values()].map(asItWas);
    this.objects.clear();
    for (const node of [...gltf.scene.children]) {
      // The loader changes names that its animations could not address.
      const name: string = node.userData['name'] ?? node.name;
      const object = scene.objects.find((o) => o.name === name);
      if (!object) continue;
      const group = new Group();
      const { light, base } = map.attributes(object);
      node.updateMatrixWorld(true);
      node.traverse((child) => {
        if (!(child instanceof Mesh)) return;
        const geometry: BufferGeometry = child.geometry;
        geometry.deleteAttribute('color');
        geometry.setAttribute('light', light);
        geometry.setAttribute('base', base);
        const from = child.material as MeshStandardMaterial;
        const emission = from.emissive.clone().multiplyScalar(from.emissiveIntensity);
        const doubleSided = from.side === 2 && !object.with_back;
        const mesh = new Mesh(geometry, surface(from.color, emission, doubleSided, from.opacity));
        mesh.matrixAutoUpdate = false;
        mesh.matrix.copy(child.matrixWorld);
        group.add(mesh);
      });
      group.matrixAutoUpdate = false;
      group.userData['picked'] = { kind: 'object', name } satisfies Picked;
      this.objects.set(name, group);
      this.scene.add(group);
    }
    this.look(scene);
    this.select(this.selected);
  }

  /** Albedo, emission and lights as the scene has them. */
  look(scene: Scene): void {
    for (const object of scene.objects) {
      const lights = scene.lights.filter((light) => light.object === object.name);
      this.materials(object.name).forEach(({ uniforms }, _, all) => {
        if (all.length === 1) uniforms['albedo']!.value.fromArray(object.albedo);
        if (all.length === 1 && lights.length < 2) {
          const strength = lights[0] ? lights[0].color.map((c) => c * lights[0]!.intensity) : [0, 0, 0];
          uniforms['emission']!.value.fromArray(strength);
        }
      });
    }
    this.mark(scene.lights, scene.objects);
    this.invalidate();
  }

  /** An albedo in advance of the service's answer. */
  paint(name: string, albedo: Point): void {
    for (const { uniforms } of this.materials(name)) uniforms['albedo']!.value.fromArray(albedo);
    this.invalidate();
  }

  select(picked: Picked | null): void {
    this.selected = picked;
    for (const [name, group] of this.objects) {
      const on = picked?.kind === 'object' && picked.name === name ? 1 : 0;
      for (const child of group.children) ((child as Mesh).material as ShaderMaterial).uniforms['selected']!.value = on;
    }
    const target = picked && (picked.kind === 'object' ? this.objects.get(picked.name) : this.markers.get(picked.name));
    if (target) {
      new Box3().setFromObject(target).getCenter(this.pivot.position);
      this.pivot.updateMatrixWorld(true);
      this.pivotStart.copy(this.pivot.matrixWorld);
      this.gizmo.attach(this.pivot);
    } else this.gizmo.detach();
    this.invalidate();
  }

  /** What dragging the gizmo does, and in which steps (0: none): metres, and 15 degrees with any. */
  gizmoDoes(mode: 'translate' | 'rotate' | 'scale', grid: number): void {
    this.gizmo.setMode(mode);
    this.gizmo.setTranslationSnap(grid || null);
    this.gizmo.setRotationSnap(grid ? Math.PI / 12 : null);
    this.gizmo.setScaleSnap(grid ? 0.1 : null);
    this.invalidate();
  }

  /** By how much an object has to rise to stand on what is below it; null where nothing is. */
  dropOf(name: string): number | null {
    const own = this.objects.get(name);
    const others = [...this.objects].filter(([other]) => other !== name).map(([, group]) => group);
    return own ? rise(own, others) : null;
  }

  /** The point of a surface in the middle of the view; where there is none, what the camera turns about. */
  ahead(): Point {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(0, 0), this.camera);
    const [hit] = ray.intersectObjects([...this.objects.values()], true);
    return (hit?.point ?? this.orbit.target).toArray() as Point;
  }

  /** Stands where a camera of the file stands, with the horizon level. */
  use(camera: Camera): void {
    this.camera.fov = (camera.fov_y * 180) / Math.PI;
    this.camera.position.fromArray(camera.eye);
    const center = this.bounds().getCenter(new Vector3());
    const ahead = new Vector3().fromArray(camera.target).sub(this.camera.position).normalize();
    // Orbits around what it looks at, about the middle of the scene.
    const distance = Math.max(center.sub(this.camera.position).dot(ahead), 0.5);
    this.orbit.target.copy(this.camera.position).addScaledVector(ahead, distance);
    this.settle();
  }

  /** The whole scene from above one corner; walls are seen through from behind. */
  overview(): void {
    const bounds = this.bounds();
    const radius = bounds.getSize(new Vector3()).length() / 2 || 1;
    this.camera.fov = 45;
    bounds.getCenter(this.orbit.target);
    this.camera.position.copy(this.orbit.target).addScaledVector(new Vector3(0.5, 0.55, 0.75), radius * 2.2);
    this.settle();
  }

  /** Turns to the selected, from where it fills most of the view. */
  frameSelected(): void {
    const shown = this.selected && (this.objects.get(this.selected.name) ?? this.markers.get(this.selected.name));
    if (!shown) return;
    const size = new Box3().setFromObject(shown).getSize(new Vector3()).length() / 2;
    const least = this.bounds().getSize(new Vector3()).length() / 12;
    const half = (Math.min(this.camera.fov, this.camera.fov * this.camera.aspect) * Math.PI) / 360;
    const back = this.camera.position.clone().sub(this.orbit.target).normalize();
    this.orbit.target.copy(this.pivot.position);
    this.camera.position.copy(this.pivot.position).addScaledVector(back, (1.25 * Math.max(size, least)) / Math.sin(half));
    this.settle();
  }

  /** The camera as the service takes it. */
  view(): View {
    const size = this.renderer.getSize(new Vector2());
    return {
      eye: this.camera.position.toArray() as Point,
      target: this.orbit.target.toArray() as Point,
      up: this.camera.up.toArray() as Point,
      fov_y: (this.camera.fov * Math.PI) / 180,
      width: Math.max(1, Math.round(size.x)),
      height: Math.max(1, Math.round(size.y)),
    };
  }

  /** Where a world-space point is on the screen, in parts of the picture from its top left. */
  project(point: Point): [number, number] {
    const p = new Vector3().fromArray(point).project(this.camera);
    return [(p.x + 1) / 2, (1 - p.y) / 2];
  }

  private materials(name: string): ShaderMaterial[] {
    return (this.objects.get(name)?.children ?? []).map((child) => (child as Mesh).material as ShaderMaterial);
  }

  private bounds(): Box3 {
    const box = new Box3();
    for (const group of this.objects.values()) box.expandByObject(group);
    return box;
  }

  private settle(): void {
    const radius = this.bounds().getSize(new Vector3()).length() || 1;
    this.camera.near = radius / 2000;
    this.camera.far = radius * 20;
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.invalidate();
    this.onCamera();
  }

  private dispose(groups: Iterable<Group>): void {
    for (const group of groups) {
      this.scene.remove(group);
      for (const child of group.children) {
        (child as Mesh).geometry.dispose();
        ((child as Mesh).material as ShaderMaterial).dispose();
      }
    }
  }

  private mark(lights: Light[], objects: SceneObject[]): void {
    for (const marker of this.markers.values()) {
      this.scene.remove(marker);
      marker.geometry.dispose();
      (marker.material as MeshBasicMaterial).dispose();
    }
    this.markers.clear();
    const radius = (objects.length ? this.bounds().getSize(new Vector3()).length() : 1) / 120;
    for (const light of lights) {
      if (!light.position) continue;
      const strongest = Math.max(...light.color, 1e-6);
      const color = new Color().setRGB(...(light.color.map((c) => c / strongest) as Point));
      const marker = new Mesh(new SphereGeometry(radius, 16, 12), new MeshBasicMaterial({ color, toneMapped: false }));
      marker.position.fromArray(light.position);
      marker.userData['picked'] = { kind: 'light', name: light.name } satisfies Picked;
      this.markers.set(light.name, marker);
      this.scene.add(marker);
    }
  }

  private dragged(): void {
    this.pivot.updateMatrix();
    const group = this.selected?.kind === 'object' && this.objects.get(this.selected.name);
    if (group) {
      // Its meshes carry their place themselves: the group's matrix is what was moved since.
      group.matrix.copy(this.pivot.matrix).multiply(this.pivotStart.clone().invert());
      group.matrixWorldNeedsUpdate = true;
    }
    if (this.selected?.kind === 'light') this.markers.get(this.selected.name)?.position.copy(this.pivot.position);
  }

  private dragging(is: boolean): void {
    this.orbit.enabled = !is;
    if (is || !this.selected) return;
    this.pivot.updateMatrix();
    const delta = this.pivot.matrix.clone().multiply(this.pivotStart.clone().invert());
    this.pivotStart.copy(this.pivot.matrix);
    if (!delta.equals(new Matrix4())) this.onMoved(this.selected, delta);
  }

  private watchClicks(): void {
    let down: Vector2 | null = null;
    this.canvas.addEventListener('pointerdown', (e) => (down = e.button === 0 ? new Vector2(e.clientX, e.clientY) : null));
    this.canvas.addEventListener('pointerup', (e) => {
      // A click, not the end of an orbit or of a drag at the gizmo.
      if (!down || down.distanceTo(new Vector2(e.clientX, e.clientY)) > 4 || this.gizmo.axis) return;
      this.onPick(this.at(e));
    });
  }

  private at(event: PointerEvent): Picked | null {
    const box = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1;
    const y = 1 - ((event.clientY - box.top) / box.height) * 2;
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.camera);
    const [hit] = ray.intersectObjects([...this.markers.values(), ...this.objects.values()], true);
    return hit?.object.userData['picked'] ?? hit?.object.parent?.userData['picked'] ?? null;
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas.parentElement!;
    const [width, height] = [Math.max(1, clientWidth), Math.max(1, clientHeight)];
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.invalidate();
  }

  /** Has what stood there before the edit in the picture, or what stands there now. */
  private showPast(is: boolean): void {
    if (!this.past) return;
    for (const group of this.past) group.visible = is;
    for (const group of this.objects.values()) group.visible = !is;
  }

  private draw(): void {
    this.dirty = false;
    const { x: width, y: height } = this.renderer.getSize(new Vector2());
    this.renderer.setScissorTest(false);
    this.renderer.clear();
    if (this.split) {
      this.renderer.setScissorTest(true);
      for (const [before, left] of [[1, 0], [0, width / 2]] as const) {
        shared.before.value = before;
        this.showPast(before === 1);
        this.renderer.setScissor(left, 0, width / 2, height);
        this.renderer.render(this.scene, this.camera);
      }
      this.renderer.setScissorTest(false);
    } else {
      shared.before.value = 0;
      this.renderer.render(this.scene, this.camera);
    }
  }
}

/** An object of before the edit: with the light of then as its own, out of the picture until it is asked for. */
function asItWas(group: Group): Group {
  group.visible = false;
  group.matrix.identity();
  group.matrixWorldNeedsUpdate = true;
  for (const child of group.children) {
    const { geometry, material } = child as Mesh<BufferGeometry, ShaderMaterial>;
    const light = new BufferAttribute(geometry.getAttribute('base').array.slice(), 3);
    geometry.setAttribute('light', light);
    geometry.setAttribute('base', light);
    material.uniforms['selected']!.value = 0;
  }
  return group;
}
