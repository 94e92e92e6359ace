// Things to put into scenes: files that were uploaded as assets while the page is open.

import { client } from './api';
import { baseName } from './dom';
import { listbox } from './lists';

export class Library {
  private readonly assets = new Map<string, string>();

  /** Uploads a file; answers its name. */
  async add(file: File): Promise<string> {
    const name = baseName(file);
    this.assets.set(name, (await client.asset(file)).asset);
    return name;
  }

  show(insert: (asset: string, name: string) => void): void {
    listbox('assets', [...this.assets.keys()].map((name) => ({ name })), null, (name) => insert(this.assets.get(name)!, name));
  }
}
