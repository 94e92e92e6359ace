// Things to put into scenes: files that were uploaded as assets while the page is open.

import { Box3, Vector3 } from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { client } from './api';
import { baseName } from './dom';
import { show } from './lists';

export interface Thing {
  name: string;
  asset: string;
  /** Where it is in its own space. */
  box: Box3;
}

export class Library {
  private readonly things = new Map<string, Thing>();

  /** Uploads a file. */
  async add(file: File): Promise<Thing> {
    const [{ asset }, box] = await Promise.all([client.asset(file), extent(file)]);
    const thing = { name: baseName(file), asset, box };
    this.things.set(thing.name, thing);
    return thing;
  }

  find(name: string): Thing | undefined {
    return this.things.get(name);
  }

  show(insert: (thing: Thing) => void): void {
    const items = [...this.things.keys()].map((name) => ({ name, isDraggable: true }));
    show('assets', items, { chosen: [], choose: ([name]) => insert(this.things.get(name!)!) });
  }
}

/** What a file fills. Of a file that only the service can read nothing is known but its origin. */
async function extent(file: File): Promise<Box3> {
  try {
    const gltf = await new GLTFLoader().parseAsync(await file.arrayBuffer(), '');
    const box = new Box3().setFromObject(gltf.scene, true);
    if (!box.isEmpty()) return box;
  } catch {
    // Compressed, or with pictures that lie elsewhere.
  }
  return new Box3(new Vector3(), new Vector3());
}
