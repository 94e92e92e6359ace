// Keys that act wherever the focus is, unless something takes them itself.

export interface KeyActions {
  undo(): void;
  redo(): void;
  remove(): void;
  duplicate(): void;
  hide(): void;
  toFloor(): void;
  letGo(): void;
  all(): void;
  split(): void;
  filter(): void;
  frame(): void;
  search(): void;
  gizmo(mode: string): void;
  expose(by: number): void;
  view(index: number): void;
}

export function watchKeys(act: KeyActions): void {
  const plain: Record<string, () => void> = {
    delete: act.remove,
    escape: act.letGo,
    end: act.toFloor,
    s: act.split,
    n: () => act.filter(),
    f: act.frame,
    h: act.hide,
    w: () => act.gizmo('translate'),
    e: () => act.gizmo('rotate'),
    r: () => act.gizmo('scale'),
    '/': act.search,
    '[': () => act.expose(-0.5),
    ']': () => act.expose(0.5),
  };
  const control: Record<string, (isShifted: boolean) => void> = {
    z: (isShifted) => (isShifted ? act.redo() : act.undo()),
    y: act.redo,
    d: act.duplicate,
    a: act.all,
  };
  document.addEventListener('keydown', (event) => {
    // What is typed belongs to where it is typed; dialogs have keys of their own. Sliders and buttons take no letters.
    const { target } = event;
    const takesText = target instanceof HTMLInputElement && !['range', 'checkbox', 'color'].includes(target.type);
    if (takesText || target instanceof HTMLSelectElement || document.querySelector('dialog[open]')) return;
    const key = event.key.toLowerCase();
    if (event.altKey) return;
    if (event.ctrlKey || event.metaKey) {
      if (!control[key]) return;
      control[key](event.shiftKey);
    } else if (plain[key]) plain[key]();
    else if (/^[1-9]$/.test(key)) act.view(Number(key) - 1);
    else return;
    event.preventDefault();
  });
}

/** Forms in dialogs close them: with `ok` where they are sent, with nothing by the other button or Escape. */
export function watchDialogs(): void {
  for (const dialog of document.querySelectorAll('dialog')) {
    dialog.querySelector('form')!.addEventListener('submit', (event) => {
      event.preventDefault();
      dialog.close('ok');
    });
    dialog.querySelector('[data-close]')!.addEventListener('click', () => dialog.close(''));
  }
}
