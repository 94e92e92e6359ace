// Building blocks of the page.

export const $ = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;

/** Builds an element. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

export function button(text: string, action: () => void, kind = ''): HTMLButtonElement {
  const element = make('button', { type: 'button', class: kind }, text);
  element.addEventListener('click', action);
  return element;
}

/** What is seen of a thing that is called by a file's name. */
export const baseName = (file: File) => file.name.replace(/\.(glb|gltf|zip|hdr|exr)$/i, '');

/** Whether a file is a picture of the sky, by its name. */
export const isSky = (file: File) => /\.(hdr|exr)$/i.test(file.name);

/** A name that is not taken yet: itself, or with a number behind it. */
export function freeName(wanted: string, taken: Iterable<string>): string {
  const names = new Set(taken);
  const stem = wanted.replace(/-\d+$/, '');
  let name = wanted;
  for (let n = 2; names.has(name); n++) name = `${stem}-${n}`;
  return name;
}
