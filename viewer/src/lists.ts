// Lists to choose from, flat or with groups: one stop of the tab key each, arrows within.

import { $, make } from './dom';

export interface Item {
  name: string;
  /** Said and shown behind the name. */
  note?: string;
  isFaint?: boolean;
  isDraggable?: boolean;
  /** It belongs to the group above. */
  isWithin?: boolean;
  /** It stands for these, which are shown where it is open. */
  group?: { names: string[]; isOpen: boolean };
}

export interface Choice {
  chosen: readonly string[];
  /** These alone, the one that was clicked last; with `isMore` beside what is chosen, or no more. */
  choose(names: string[], isMore: boolean): void;
  /** Opens or closes a group. */
  open?(group: string, is: boolean): void;
}

interface List extends Choice {
  parent: HTMLElement;
  items: Item[];
  rows: HTMLLIElement[];
}

/** Names that a row stands for. */
const namesOf = (item: Item) => item.group?.names ?? [item.name];
const keyOf = (item: Item) => (item.group ? `group ${item.name}` : item.name);

/** Shows a list; what is the same as before stays as it is. */
export function show(id: string, items: Item[], choice: Choice): void {
  const parent = $<HTMLUListElement>(id);
  const { chosen } = choice;
  const shown = JSON.stringify([items, chosen]);
  if (parent.dataset['shown'] === shown) return;
  parent.dataset['shown'] = shown;
  const hadFocus = parent.contains(document.activeElement);
  const focused = hadFocus ? (document.activeElement as HTMLElement).dataset['key'] : undefined;
  const keys = items.map(keyOf);
  // Where the tab key gets in: what had the focus, else what was chosen last, else the first.
  const stop = [focused, chosen.at(-1), keys[0]].find((key) => key != null && keys.includes(key));
  const isChosen = new Set(chosen);
  const role = parent.getAttribute('role') === 'tree' ? 'treeitem' : 'option';
  const rows = items.map((item) => {
    const isSelected = namesOf(item).every((name) => isChosen.has(name));
    const row = make('li', { role, 'aria-selected': String(isSelected), title: item.name });
    if (item.group) row.append(make('i', { class: 'twist' }, item.group.isOpen ? '▾' : '▸'));
    row.append(item.name);
    if (item.group) row.setAttribute('aria-expanded', String(item.group.isOpen));
    else row.dataset['name'] = item.name;
    if (role === 'treeitem') row.setAttribute('aria-level', item.isWithin ? '2' : '1');
    row.dataset['key'] = keyOf(item);
    row.tabIndex = keyOf(item) === stop ? 0 : -1;
    row.draggable = item.isDraggable ?? false;
    if (item.note) row.append(make('small', {}, ` ${item.note}`));
    row.classList.toggle('faint', item.isFaint ?? false);
    row.classList.toggle('within', item.isWithin ?? false);
    return row;
  });
  parent.replaceChildren(...rows);
  const list: List = { ...choice, parent, items, rows };
  parent.onclick = (event) => clicked(event, list);
  parent.onkeydown = (event) => keyed(event, list);
  if (hadFocus) rows.find((row) => row.tabIndex === 0)?.focus();
  else rows.find((row) => row.dataset['name'] === chosen.at(-1))?.scrollIntoView({ block: 'nearest' });
}

function clicked(event: MouseEvent, list: List): void {
  const target = event.target as HTMLElement;
  const at = list.rows.indexOf(target.closest('li')!);
  const item = list.items[at];
  if (!item) return;
  if (item.group && target.classList.contains('twist')) list.open?.(item.name, !item.group.isOpen);
  else if (event.shiftKey) upTo(at, list);
  else only(at, list, event.ctrlKey || event.metaKey);
}

/** Chooses one row; what shift chooses later begins there. */
function only(at: number, { parent, items, choose }: List, isMore = false): void {
  parent.dataset['anchor'] = keyOf(items[at]!);
  choose(namesOf(items[at]!), isMore);
}

/** Chooses what lies between the row that was chosen before and this one. */
function upTo(at: number, { parent, items, choose }: List): void {
  const anchor = Math.max(items.findIndex((item) => keyOf(item) === parent.dataset['anchor']), 0);
  const between = items.slice(Math.min(anchor, at), Math.max(anchor, at) + 1);
  const names = (at < anchor ? between.reverse() : between).flatMap(namesOf);
  choose([...new Set(names)], false);
}

function keyed(event: KeyboardEvent, list: List): void {
  const { rows, items } = list;
  const at = rows.indexOf(document.activeElement as HTMLLIElement);
  if (at < 0) return;
  const isMore = event.ctrlKey || event.metaKey;
  const item = items[at]!;
  const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: rows.length - 1, PageDown: at + 10, PageUp: at - 10 }[event.key];
  if (to !== undefined) {
    const next = Math.max(0, Math.min(rows.length - 1, to));
    for (const row of rows) row.tabIndex = row === rows[next] ? 0 : -1;
    rows[next]!.focus();
    if (event.shiftKey) upTo(next, list);
  } else if (event.key === 'Enter' || event.key === ' ') only(at, list, isMore);
  else if (event.key === 'a' && isMore) list.choose([...new Set(items.flatMap(namesOf))], false);
  else if (item.group && ['ArrowLeft', 'ArrowRight'].includes(event.key)) list.open?.(item.name, event.key === 'ArrowRight');
  else return;
  event.preventDefault();
  event.stopPropagation();
}
