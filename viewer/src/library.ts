// Things to put into scenes: the assets of the service, those of this page by the names of their files.

import { Box3, Vector3 } from 'three';
import type { AssetSummary } from 'rebake';
import { client } from './api';
import { baseName, freeName } from './dom';
import { show } from './lists';

export interface Thing {
  name: string;
  asset: string;
  /** Where it is in its own space; absent of a picture of the sky. */
  box?: Box3;
}

export class Library {
  private things = new Map<string, Thing>();

  /** Uploads a file. */
  async add(file: File): Promise<Thing> {
    const { asset } = await client.asset(file);
    await this.refresh(new Map([[asset, baseName(file)]]));
    return [...this.things.values()].find((thing) => thing.asset === asset)!;
  }

  /** Asks the service what there is, newest first; `named`: what to call some of it. */
  async refresh(named = new Map<string, string>()): Promise<void> {
    const known = new Map([...this.things.values()].map(({ asset, name }) => [asset, name]));
    const things = new Map<string, Thing>();
    for (const about of await client.assets()) {
      const wanted = named.get(about.asset) ?? known.get(about.asset) ?? about.name ?? 'sky';
      const name = freeName(wanted, things.keys());
      things.set(name, { name, asset: about.asset, ...boxOf(about) });
    }
    this.things = things;
  }

  find(name: string): Thing | undefined {
    return this.things.get(name);
  }

  show(use: (thing: Thing) => void): void {
    const items = [...this.things.values()].map(({ name, box }) => ({ name, isDraggable: true, ...(!box && { note: 'sky' }) }));
    show('assets', items, { chosen: [], choose: ([name]) => use(this.things.get(name!)!) });
  }
}

function boxOf({ picture, bounds }: AssetSummary): { box?: Box3 } {
  if (picture) return {};
  return { box: bounds ? new Box3(new Vector3(...bounds.min), new Vector3(...bounds.max)) : new Box3(new Vector3(), new Vector3()) };
}
