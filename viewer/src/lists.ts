// Lists to choose from: one stop of the tab key each, arrows within.

import { $, make } from './dom';

export interface Item {
  name: string;
  /** Said and shown behind the name. */
  note?: string;
  isFaint?: boolean;
}

/** Shows a list; what is the same as before stays as it is. */
export function listbox(id: string, items: Item[], chosen: string | null, choose: (name: string) => void): void {
  const parent = $<HTMLUListElement>(id);
  const shown = JSON.stringify([items, chosen]);
  if (parent.dataset['shown'] === shown) return;
  parent.dataset['shown'] = shown;
  const hadFocus = parent.contains(document.activeElement);
  const focused = hadFocus ? (document.activeElement as HTMLElement).dataset['name'] : undefined;
  const names = items.map((item) => item.name);
  // Where the tab key gets in: what is chosen, else what had the focus, else the first.
  const stop = [chosen, focused, names[0]].find((name) => name != null && names.includes(name));
  const rows = items.map((item) => {
    const row = make('li', { role: 'option', 'aria-selected': String(item.name === chosen), title: item.name }, item.name);
    row.dataset['name'] = item.name;
    row.tabIndex = item.name === stop ? 0 : -1;
    if (item.note) row.append(make('small', {}, ` ${item.note}`));
    row.classList.toggle('faint', item.isFaint ?? false);
    return row;
  });
  parent.replaceChildren(...rows);
  parent.onclick = (event) => {
    const name = (event.target as HTMLElement).closest('li')?.dataset['name'];
    if (name !== undefined) choose(name);
  };
  parent.onkeydown = (event) => keyed(event, rows, choose);
  if (hadFocus) (rows.find((row) => row.dataset['name'] === focused) ?? rows.find((row) => row.tabIndex === 0))?.focus();
  else rows.find((row) => row.dataset['name'] === chosen)?.scrollIntoView({ block: 'nearest' });
}

function keyed(event: KeyboardEvent, rows: HTMLLIElement[], choose: (name: string) => void): void {
  const at = rows.indexOf(document.activeElement as HTMLLIElement);
  if (at < 0 || event.ctrlKey || event.metaKey) return;
  const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: rows.length - 1, PageDown: at + 10, PageUp: at - 10 }[event.key];
  if (to !== undefined) {
    const next = rows[Math.max(0, Math.min(rows.length - 1, to))]!;
    for (const row of rows) row.tabIndex = row === next ? 0 : -1;
    next.focus();
  } else if (event.key === 'Enter' || event.key === ' ') choose(rows[at]!.dataset['name']!);
  else return;
  event.preventDefault();
  event.stopPropagation();
}
