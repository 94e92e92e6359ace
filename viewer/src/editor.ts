// Sends edits, one request after the other, each for the state that the page has seen: what somebody else has done
// meanwhile is shown before anything is done on top of it. Undo, redo and the history are the service's.

import { Refused, Unreachable, type Edit, type HistoryPage, type Job, type Scene } from 'rebake';
import { client, type View } from './api';
import { describe, turned } from './requests';

interface Wish {
  label: string;
  edits: Edit[];
  /** The same for every attempt: a request that has come through counts once. */
  key: string;
  scene: string;
  /** It goes on with what the request before began: what was before that is still what was before. */
  isOn: boolean;
  settled(accepted: Job | null): void;
}

export interface EditorEvents {
  scene(): Scene | null;
  view(): View;
  /** An edit is about to be sent. */
  before(): void;
  accepted(job: Job, label: string): void;
  /** Others were faster. `again` sends it for what is there now. */
  conflict(label: string, again: () => void): void;
  /** So many edits wait for a service that is away; 0: none does any more. */
  waiting(labels: string[]): void;
  /** It will never be made. */
  dropped(label: string, why: string): void;
  history(page: HistoryPage | null): void;
}

export class Editor {
  history: HistoryPage | null = null;
  private readonly queue: Wish[] = [];
  private isSending = false;
  private isAway = false;
  private retry = () => {};
  private turning: Promise<void> = Promise.resolve();

  constructor(private readonly events: EditorEvents) {}

  /** Another scene is shown: what waits belongs to the one before, and is dropped with a word. */
  clear(): void {
    for (const wish of this.queue.splice(0)) this.drop(wish, 'the scene was left');
    this.events.waiting([]);
    this.history = null;
    this.events.history(null);
  }

  /** Nothing waits for the service. */
  get isIdle(): boolean {
    return !this.isSending;
  }

  /** The service is back. */
  resume(): void {
    this.isAway = false;
    this.retry();
  }

  /** Gives up what waits. */
  dropAll(): void {
    for (const wish of this.queue.splice(0)) this.drop(wish, 'it was given up');
    this.events.waiting([]);
    this.retry();
  }

  /** Sends an edit; null where it was not accepted, which has been said then. */
  run(label: string, edits: Edit | Edit[], isOn = false): Promise<Job | null> {
    const scene = this.events.scene();
    if (!scene) return Promise.resolve(null);
    return new Promise((settled) => {
      const all = Array.isArray(edits) ? edits : [edits];
      this.queue.push({ label, edits: all, key: crypto.randomUUID(), scene: scene.id, isOn, settled });
      void this.work();
    });
  }

  undo = () => this.step('undo');
  redo = () => this.step('redo');

  /** Looks at the history anew. */
  async refresh(): Promise<void> {
    const scene = this.events.scene();
    if (!scene) return;
    const page = await client.history(scene.id);
    if (this.events.scene()?.id !== scene.id) return;
    this.history = page;
    this.events.history(page);
  }

  /** A drag is taken back, and made again, as a whole. One after the other: what comes next depends on what was turned. */
  private step(op: 'undo' | 'redo'): Promise<void> {
    const turn = async () => {
      await this.refresh().catch(() => {});
      const those = this.history ? turned(this.history, op) : [];
      if (those[0]) await this.run(`${op}: ${describe(those[0].request)}`, { op, drag: true });
    };
    this.turning = this.turning.then(turn);
    return this.turning;
  }

  private async work(): Promise<void> {
    if (this.isSending) return;
    this.isSending = true;
    for (let wish = this.queue[0]; wish; wish = this.queue[0]) {
      const outcome = await this.attempt(wish);
      if (outcome === 'away') {
        this.isAway = true;
        this.events.waiting(this.queue.map((one) => one.label));
        await new Promise<void>((done) => {
          this.retry = done;
          setTimeout(done, 2000);
        });
        continue;
      }
      if (this.queue[0] === wish) this.queue.shift();
      if (this.isAway || this.queue.length === 0) this.events.waiting([]);
      this.isAway = false;
    }
    this.isSending = false;
  }

  private async attempt(wish: Wish): Promise<'done' | 'away'> {
    const scene = this.events.scene();
    if (scene?.id !== wish.scene) return this.drop(wish, 'the scene was left');
    if (!wish.isOn) this.events.before();
    // Undo and redo stand alone in their request.
    const edits = wish.edits.length === 1 ? wish.edits[0]! : wish.edits;
    const options = { focus: this.events.view(), ifMatch: scene.accepted_edits, idempotencyKey: wish.key };
    try {
      const job = await client.edit(scene.id, edits, options);
      // What comes next is made for this; the scene may have been looked at anew meanwhile.
      const now = this.events.scene();
      if (now?.id === scene.id) now.accepted_edits = Math.max(now.accepted_edits, job.accepted_edits);
      this.events.accepted(job, wish.label);
      wish.settled(job);
      void this.refresh().catch(() => {});
    } catch (error) {
      if (error instanceof Unreachable || (error instanceof Refused && error.status === 503)) return 'away';
      if (error instanceof Refused && error.status === 412) {
        wish.settled(null);
        this.events.conflict(wish.label, () => void this.run(wish.label, wish.edits));
      } else return this.drop(wish, error instanceof Error ? error.message : String(error));
    }
    return 'done';
  }

  private drop(wish: Wish, why: string): 'done' {
    this.events.dropped(wish.label, why);
    wish.settled(null);
    return 'done';
  }
}
