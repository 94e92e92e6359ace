// Files that a person chooses, and what is dropped on the page.

import { $, baseName, isSky } from './dom';

/** Calls `take` with every file chosen in an input. */
export function onFile(id: string, take: (file: File) => void): void {
  $<HTMLInputElement>(id).addEventListener('change', ({ target }) => {
    const input = target as HTMLInputElement;
    const file = input.files?.[0];
    // Choosing the same file again is a change too.
    input.value = '';
    if (file) take(file);
  });
}

export interface Drops {
  /** Whether there is a scene to put things into. */
  canPlace(): boolean;
  /** A file that is a scene of its own. */
  scene(file: File): void;
  /** A file for the library. */
  library(file: File): void;
  /** A file, or something from the library by its name, for the place under the pointer. */
  place(what: File | string, at: MouseEvent): void;
}

/** What is dragged from the library. */
const THING = 'application/x-rebake-thing';

/** Watches what is dropped: onto the scene it is put there, onto the library it is kept, elsewhere it is a new scene. */
export function watchDrops(drops: Drops): void {
  $('assets').addEventListener('dragstart', ({ target, dataTransfer }) => {
    dataTransfer?.setData(THING, (target as HTMLElement).dataset['name'] ?? '');
  });
  const over = (event: DragEvent, id: string) => $(id).contains(event.target as Node);
  const use = (event: DragEvent): keyof Drops => {
    if (!drops.canPlace()) return 'scene';
    return over(event, 'stage') ? 'place' : over(event, 'library') ? 'library' : 'scene';
  };
  const words = { place: 'Drop it where it shall stand', library: 'Drop it to keep it for later', scene: 'Drop it to open it as a scene of its own', canPlace: '' };
  const end = () => document.body.classList.remove('dropping');
  document.addEventListener('dragover', (event) => {
    event.preventDefault();
    document.body.classList.add('dropping');
    $('drop-hint').textContent = words[use(event)];
  });
  document.addEventListener('dragleave', (event) => event.relatedTarget ?? end());
  document.addEventListener('dragend', end);
  document.addEventListener('drop', (event) => {
    event.preventDefault();
    end();
    const thing = event.dataTransfer?.getData(THING);
    const file = event.dataTransfer?.files[0];
    if (thing) return use(event) === 'place' ? drops.place(thing, event) : undefined;
    if (!file) return;
    // An archive holds a scene; so does what is dropped where there is none. A sky is where it is dropped, there.
    const isScene = baseName(file) !== file.name && file.name.toLowerCase().endsWith('.zip');
    const kind = isScene ? 'scene' : isSky(file) && use(event) !== 'library' ? 'place' : use(event);
    if (kind === 'place') drops.place(file, event);
    else if (kind === 'library') drops.library(file);
    else drops.scene(file);
  });
}
