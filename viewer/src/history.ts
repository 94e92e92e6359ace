// The scene's edit requests, as the service has them.

import type { HistoryEntry, HistoryPage } from 'rebake';
import { $, make } from './dom';
import { describe } from './editor';

const SHOWN = 40;

/** The list, newest first, and what the buttons would take back or make again. */
export function showHistory(page: HistoryPage | null): void {
  // What was undone and cannot be made again any more is of no use to anybody.
  const counts = ({ undone, sequence }: HistoryEntry) => !undone || (page?.redo != null && sequence >= page.redo);
  const entries = (page?.items ?? []).filter((entry) => entry.undoes == null && entry.redoes == null && counts(entry));
  const rows = entries.slice(-SHOWN).reverse().map((entry) => {
    const row = make('li', {}, describe(entry.request));
    row.classList.toggle('faint', entry.undone);
    if (entry.undone) row.append(make('small', {}, ' undone'));
    if (entry.accepted_at) row.title = new Date(entry.accepted_at).toLocaleString();
    if (entry.sequence === page?.undo) row.setAttribute('aria-current', 'step');
    return row;
  });
  $('history').replaceChildren(...(rows.length ? rows : [make('li', { class: 'quiet' }, 'No edits yet.')]));
  for (const [id, sequence] of [['undo', page?.undo], ['redo', page?.redo]] as const) {
    const entry = page?.items.find((item) => item.sequence === sequence);
    const of = $<HTMLButtonElement>(id);
    of.disabled = !entry;
    of.title = entry ? `${id}: ${describe(entry.request)}` : `nothing to ${id}`;
  }
}
