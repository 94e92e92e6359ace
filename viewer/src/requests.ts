// Edit requests as a scene's history has them: in words, and what of them belongs together.

import type { Edit, HistoryEntry, HistoryPage } from 'rebake';

const editsOf = (request: object) => ('edits' in request ? request.edits : [request]) as Edit[];

/** What a request drags along, where it does nothing else; it is a step then, and not where that comes to rest. */
function draggedBy({ request }: HistoryEntry): string | null {
  const areSteps = editsOf(request).every((edit) => (edit.op === 'move_light' || edit.op === 'move') && edit.drag);
  return areSteps ? movedBy(request) : null;
}

function movedBy(request: object): string | null {
  const moved = editsOf(request).map((edit) => (edit.op === 'move_light' ? `light ${edit.light}` : edit.op === 'move' ? `object ${edit.object}` : null));
  return moved.includes(null) ? null : JSON.stringify(moved);
}

/** Whether a request is a step of a drag that goes on in the next one. */
const goesOn = (entry: HistoryEntry, next: HistoryEntry | undefined) => next !== undefined && draggedBy(entry) === movedBy(next.request) && draggedBy(entry) !== null;

/** What was asked for, oldest first, without undo, redo, and what was undone and cannot be made again any more. */
function wishes({ items, redo }: HistoryPage): HistoryEntry[] {
  const counts = ({ undone, sequence }: HistoryEntry) => !undone || (redo != null && sequence >= redo);
  return items.filter((entry) => entry.undoes == null && entry.redoes == null && counts(entry));
}

/** What a person did: of a drag the request that ended it. */
export function deeds(page: HistoryPage): HistoryEntry[] {
  const all = wishes(page);
  return all.filter((entry, k) => !(goesOn(entry, all[k + 1]) && entry.undone === all[k + 1]!.undone));
}

/** The requests that are taken back, or made again, next: one, or all of a drag. */
export function turned(page: HistoryPage, op: 'undo' | 'redo'): HistoryEntry[] {
  const all = wishes(page).filter(({ undone }) => undone === (op === 'redo'));
  const at = all.findIndex(({ sequence }) => sequence === page[op]);
  if (at < 0) return [];
  let [first, last] = [at, at];
  if (op === 'undo') while (first > 0 && goesOn(all[first - 1]!, all[first])) first--;
  else while (goesOn(all[last]!, all[last + 1])) last++;
  return op === 'undo' ? all.slice(first, at + 1).reverse() : all.slice(at, last + 1);
}

/** An edit request in a few words. */
export function describe(request: object): string {
  const edits = editsOf(request);
  const first = edits[0] ? one(edits[0]) : 'nothing';
  return edits.length > 1 ? `${first} and ${edits.length - 1} more` : first;
}

function one(edit: Edit): string {
  // What was accepted has names in place of nodes.
  const some = (names: unknown[]) => (names.length > 1 ? `${String(names[0])} and ${names.length - 1} more` : String(names[0] ?? ''));
  switch (edit.op) {
    case 'insert':
    case 'insert_light': return `insert ${edit.name}`;
    case 'remove': return `remove ${some(edit.objects)}`;
    case 'hide': return `hide ${some(edit.objects)}`;
    case 'show': return `show ${some(edit.objects)}`;
    case 'move': return `move ${some([edit.object])}`;
    case 'material': return `repaint ${some([edit.object ?? edit.material])}`;
    case 'relight': return `relight ${some(edit.lights.map((light) => light.light))}`;
    case 'remove_light': return `remove ${some([edit.light])}`;
    case 'move_light': return `move ${some([edit.light])}`;
    case 'group_lights': return `group ${some(edit.lights)}`;
    case 'sky': return 'sky';
    default: return edit.op;
  }
}
