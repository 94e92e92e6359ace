// Files that a person chooses or drops.

import { $ } from './dom';

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

/** Calls `take` with every file dropped on the page. */
export function onDrop(take: (file: File) => void): void {
  document.addEventListener('dragover', (event) => {
    event.preventDefault();
    document.body.classList.add('dropping');
  });
  document.addEventListener('dragleave', (event) => event.relatedTarget ?? document.body.classList.remove('dropping'));
  document.addEventListener('drop', (event) => {
    event.preventDefault();
    document.body.classList.remove('dropping');
    const file = event.dataTransfer?.files[0];
    if (file) take(file);
  });
}
