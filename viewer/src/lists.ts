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

/** Shows a list. Rows stay what they are by their keys: a click that has begun, the focus, and what a screen reader has in
 * hand outlive an update. */
export function show(id: string, items: Item[], choice: Choice): void {
  const parent = $<HTMLUListElement>(id);
  const { chosen } = choice;
  const before = new Map([...parent.children].map((row) => [(row as HTMLLIElement).dataset['key']!, row as HTMLLIElement]));
  const hadFocus = parent.contains(document.activeElement);
  const focused = hadFocus ? (document.activeElement as HTMLElement).dataset['key'] : undefined;
  const keys = items.map(keyOf);
  // Where the tab key gets in: what had the focus, else what was chosen last, else the first.
  const known = new Set(keys);
  const stop = [focused, chosen.at(-1), keys[0]].find((key) => key != null && known.has(key));
  const isChosen = new Set(chosen);
  const role = parent.getAttribute('role') === 'tree' ? 'treeitem' : 'option';
  const rows = items.map((item, at) => {
    const row = before.get(keys[at]!) ?? make('li', { role });
    before.delete(keys[at]!);
    fill(row, item, namesOf(item).every((name) => isChosen.has(name)), keys[at] === stop);
    return row;
  });
  for (const gone of before.values()) gone.remove();
  // Only those that stand elsewhere are moved: a row that is taken out loses the focus.
  rows.forEach((row, at) => {
    if (parent.children[at] !== row) parent.insertBefore(row, parent.children[at] ?? null);
  });
  const list: List = { ...choice, parent, items, rows };
  parent.onclick = (event) => clicked(event, list);
  parent.onkeydown = (event) => keyed(event, list);
  const last = chosen.at(-1);
  const isNews = parent.dataset['last'] !== (last ?? '');
  parent.dataset['last'] = last ?? '';
  if (hadFocus && !parent.contains(document.activeElement)) rows.find((row) => row.tabIndex === 0)?.focus();
  else if (isNews && !hadFocus) rows.find((row) => row.dataset['name'] === last)?.scrollIntoView({ block: 'nearest' });
}

/** Has a row tell an item; what it tells already is left alone. */
function fill(row: HTMLLIElement, item: Item, isSelected: boolean, isStop: boolean): void {
  const set = (name: string, value: string | null) => {
    if (row.getAttribute(name) === value) return;
    if (value === null) row.removeAttribute(name);
    else row.setAttribute(name, value);
  };
  set('aria-selected', String(isSelected));
  set('title', item.name);
  set('aria-expanded', item.group ? String(item.group.isOpen) : null);
  set('data-name', item.group ? null : item.name);
  set('data-key', keyOf(item));
  if (row.getAttribute('role') === 'treeitem') set('aria-level', item.isWithin ? '2' : '1');
  set('tabindex', isStop ? '0' : '-1');
  set('draggable', String(item.isDraggable ?? false));
  row.classList.toggle('faint', item.isFaint ?? false);
  row.classList.toggle('within', item.isWithin ?? false);
  const text = JSON.stringify([item.name, item.note, item.group?.isOpen]);
  if (row.dataset['text'] === text) return;
  row.dataset['text'] = text;
  const parts: (Node | string)[] = [item.name];
  if (item.group) parts.unshift(make('i', { class: 'twist' }, item.group.isOpen ? '▾' : '▸'));
  if (item.note) parts.push(make('small', {}, ` ${item.note}`));
  row.replaceChildren(...parts);
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
    for (const row of list.parent.querySelectorAll<HTMLLIElement>('[tabindex="0"]')) row.tabIndex = -1;
    rows[next]!.tabIndex = 0;
    rows[next]!.focus();
    if (event.shiftKey) upTo(next, list);
  } else if (event.key === 'Enter' || event.key === ' ') only(at, list, isMore);
  else if (event.key === 'a' && isMore) list.choose([...new Set(items.flatMap(namesOf))], false);
  else if (item.group && ['ArrowLeft', 'ArrowRight'].includes(event.key)) list.open?.(item.name, event.key === 'ArrowRight');
  else return;
  event.preventDefault();
  event.stopPropagation();
}
