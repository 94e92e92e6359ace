// One scene as a whole: its name, its target, files to take away, and its end.

import type { Budget, Scene } from 'rebake';
import { client } from './api';
import { $, button, make } from './dom';

interface Changes {
  renamed(scene: Scene): void;
  deleted(): void;
  attempt(what: () => Promise<unknown>): Promise<void>;
}

export function showScene(scene: Scene, changes: Changes): void {
  const dialog = $<HTMLDialogElement>('scene-dialog');
  const [name, samples, error] = ['scene-name', 'scene-samples', 'scene-error'].map((id) => $<HTMLInputElement>(id));
  name!.value = scene.name;
  samples!.value = String(scene.target?.samples_per_element ?? '');
  error!.value = String(scene.target?.target_rmse ?? '');
  const target = scene.texels_per_metre ? `, atlas with ${scene.texels_per_metre} texels per metre` : '';
  $('scene-about').textContent = `${scene.id}: ${scene.elements.toLocaleString('en')} elements, mode ${scene.mode}, spacing ${scene.spacing} m${target}`;
  $('scene-files').replaceChildren(...files(scene, changes));
  const remove = button('Delete this scene', () => {
    // Once more, in words: it cannot be taken back.
    if (remove.dataset['sure']) {
      void changes.attempt(async () => {
        await client.delete(scene.id);
        changes.deleted();
      });
      dialog.close();
    } else {
      remove.dataset['sure'] = 'yes';
      remove.textContent = 'Delete it for good, with its light and history';
    }
  }, 'bad');
  $('scene-delete').replaceChildren(remove);
  dialog.onclose = () => {
    if (dialog.returnValue !== 'ok') return;
    // What is not asked here stays as it is.
    const next: Budget = { ...scene.target };
    if (Number(samples!.value) > 0) next.samples_per_element = Math.round(Number(samples!.value));
    else delete next.samples_per_element;
    if (Number(error!.value) > 0) next.target_rmse = Number(error!.value);
    else delete next.target_rmse;
    const isNew = samples!.value !== String(scene.target?.samples_per_element ?? '') || error!.value !== String(scene.target?.target_rmse ?? '');
    const patch = { ...(name!.value !== scene.name && { name: name!.value }), ...(isNew && Object.keys(next).length && { target: next }) };
    if (Object.keys(patch).length) void changes.attempt(async () => changes.renamed(await client.change(scene.id, patch)));
  };
  dialog.returnValue = '';
  dialog.showModal();
}

function files(scene: Scene, { attempt }: Changes): HTMLElement[] {
  const stem = scene.name || scene.id;
  const take = (text: string, name: string, fetch: () => Promise<ArrayBuffer>) =>
    button(text, () => void attempt(async () => save(await fetch(), name)));
  const made: HTMLElement[] = [
    take('Light at vertices (.glb)', `${stem}-lit.glb`, () => client.lightMap(scene.id, { format: 'glb' })),
    take('Light map (.exr)', `${stem}.exr`, () => client.lightMap(scene.id, { format: 'exr' })),
    take('With atlas (.glb)', `${stem}-atlas.glb`, () => client.lightMap(scene.id, { format: 'glb', layout: 'atlas' })),
  ];
  made.push(button('Atlas pages (.exr)', () => void attempt(async () => {
    const atlas = await client.atlas(scene.id);
    for (const page of atlas.pages.keys()) save(await client.atlasPage(scene.id, page), `${stem}-atlas-${page}.exr`);
    save(new TextEncoder().encode(JSON.stringify(atlas, null, 1)), `${stem}-atlas.json`);
  })));
  return made;
}

function save(bytes: BlobPart, name: string): void {
  const link = make('a', { download: name, href: URL.createObjectURL(new Blob([bytes])) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Has the names of all scenes to choose from; answers them. */
export async function nameScenes(current?: string) {
  const scenes = await client.scenes();
  const select = $<HTMLSelectElement>('scenes');
  select.replaceChildren(...scenes.map((s) => make('option', { value: s.id }, s.name || s.id)));
  if (scenes.length === 0) select.append(make('option', { value: '' }, 'none yet'));
  if (current) select.value = current;
  return scenes;
}

/** Has the cameras of the file to choose from, the first one chosen. */
export function nameCameras({ cameras }: Scene): void {
  const option = (value: string, text: string) => make('option', { value }, text);
  const select = $<HTMLSelectElement>('cameras');
  select.replaceChildren(option('', 'overview'), ...cameras.map((c) => option(String(c.index), c.name || `camera ${c.index}`)));
  select.value = cameras.length ? '0' : '';
}
