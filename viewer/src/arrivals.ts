// Files that come to the page: a scene of its own, a thing for the library, a thing in its place.

import type { Scene, Upload } from 'rebake';
import { client } from './api';
import type { Commands } from './commands';
import type { Library } from './library';
import { banner, say } from './messages';
import type { Stage } from './stage';

interface Page {
  scene(): Scene | null;
  open(id: string): Promise<void>;
  panels(): void;
}

export class Arrivals {
  constructor(
    private readonly page: Page,
    private readonly library: Library,
    private readonly stage: Stage,
    private readonly commands: Commands,
  ) {}

  async upload(file: File, settings: Upload | null): Promise<void> {
    if (!settings) return;
    say(`Uploading ${file.name}…`);
    const created = await client.upload(file, settings);
    await this.page.open(created.id);
    if (created.warnings.length && this.page.scene()?.lights.length) banner(created.warnings.join('; '), true, { 'All right': () => {} });
  }

  async asset(file: File): Promise<void> {
    const { name } = await this.library.add(file);
    say(`${name} is in the library: choose it to put it into the scene, or drag it there`);
    this.page.panels();
  }

  /** Something is dropped onto the scene: it comes to stand there. */
  async place(what: File | string, at: MouseEvent): Promise<void> {
    if (!this.page.scene()) throw new Error('A picture of the sky belongs to a scene: open one first, or choose it at its upload.');
    const where = this.stage.spotUnder(at) ?? this.stage.ahead();
    const thing = typeof what === 'string' ? this.library.find(what) : await this.library.add(what);
    this.page.panels();
    if (thing) await this.commands.insert(thing, where);
  }
}
