// The buttons, lists and sliders around the scene.

import { $ } from './dom';
import type { LampKind } from './lamps';

export interface ControlActions {
  open(scene: string): void;
  about(): void;
  undo(): void;
  redo(): void;
  addLight(kind: LampKind): void;
  search(): void;
  gizmo(): void;
  dropWaiting(): void;
  view(name: string): void;
  filter(is: boolean): void;
  split(is: boolean): void;
  camera(): void;
  expose(stops: number): void;
}

export function watchControls(act: ControlActions): void {
  const clicked = (id: string, does: () => void) => $(id).addEventListener('click', does);
  const changed = (id: string, does: (value: string, is: boolean) => void, event = 'change') =>
    $<HTMLInputElement>(id).addEventListener(event, () => does($<HTMLInputElement>(id).value, $<HTMLInputElement>(id).checked));
  clicked('upload', () => $('file').click());
  clicked('add-asset', () => $('asset-file').click());
  clicked('scene-more', act.about);
  clicked('undo', act.undo);
  clicked('redo', act.redo);
  clicked('waiting-drop', act.dropWaiting);
  changed('scenes', act.open);
  changed('add-light', (kind) => {
    $<HTMLSelectElement>('add-light').value = '';
    if (kind) act.addLight(kind as LampKind);
  });
  changed('search', act.search, 'input');
  changed('gizmo', act.gizmo);
  changed('grid', act.gizmo);
  changed('view', act.view);
  changed('filter', (_, is) => act.filter(is));
  changed('split', (_, is) => act.split(is));
  changed('cameras', act.camera);
  changed('exposure', (stops) => act.expose(Number(stops)), 'input');
}
