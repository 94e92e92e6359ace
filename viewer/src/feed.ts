// What the service tells of the scene that is shown: its jobs, its events, its light map as it changes.

import { isOpen, makeWorker, streamInWorker, type Filter, type FromWorker, type Job, type Snapshot, type LightError } from 'rebake';
import { client } from './api';
import { banner, say } from './messages';
import { merge } from './work';

export interface FeedEvents {
  /** A job is new, or further. */
  job(job: Job): void;
  /** All jobs were listed. */
  jobs(): void;
  /** Objects, lights or elements are others. */
  scene(): Promise<void>;
  snapshot(snapshot: Snapshot): void;
  /** The map has a stated error, and is of elements of a version. */
  stated(error: number | null, each: LightError, elementsVersion: number): void;
  /** The connection is back after it was lost. */
  back(): Promise<void>;
  deleted(): void;
  attempt(what: () => Promise<unknown>): Promise<void>;
}

export class Feed {
  jobs: Job[] = [];
  /** Version of the light map that has come. */
  version = 0;
  /** Whether noise is averaged away in what comes. */
  filter: Filter = 'statistical';

  private readonly worker = makeWorker();
  private events = new AbortController();
  private stopStream = () => {};
  private isLost = false;
  private scene: string | null = null;

  constructor(private readonly heard: FeedEvents) {}

  /** Follows a scene. */
  follow(scene: string): void {
    this.scene = scene;
    this.stream();
    void this.heard.attempt(() => this.listen(scene));
  }

  stop(): void {
    this.stopStream();
    this.events.abort();
    [this.scene, this.jobs, this.version] = [null, [], 0];
  }

  /** From now on with its noise averaged away, or as it is kept: all of it comes anew. */
  setFilter(filter: Filter): void {
    this.filter = filter;
    if (!this.scene) return;
    this.stopStream();
    this.stream();
  }

  told(job: Job): void {
    this.jobs = merge(this.jobs, job);
    this.heard.job(job);
  }

  /** No job that is over has light which has not come yet. */
  get isComplete(): boolean {
    return this.jobs.every((job) => !isOpen(job) && (job.progress.version ?? 0) <= this.version);
  }

  private stream(): void {
    this.stopStream = streamInWorker(this.worker, client, this.scene!, (event) => this.streamed(event), { filter: this.filter });
  }

  private async listen(id: string): Promise<void> {
    const { heard } = this;
    this.events = new AbortController();
    const { signal } = this.events;
    for await (const { type, data } of client.events(id, signal)) {
      if (signal.aborted) return;
      // Awaited, so that no older list comes after what events tell of a job.
      if (type === 'scene_state') await heard.attempt(() => this.listJobs(id));
      else if (type === 'job') this.told(data);
      else if (type === 'scene' && data.what === 'deleted') heard.deleted();
      else if (type === 'scene') void heard.attempt(() => heard.scene());
      else if (type === 'reset') await heard.attempt(() => this.listJobs(id).then(() => heard.scene()));
      else if (type === 'snapshot') heard.stated(data.estimated_rmse ?? null, data.light_error, data.elements_version);
    }
  }

  /** Only once its events are heard: what ended before would never be told. */
  private async listJobs(id: string): Promise<void> {
    const all = await client.jobs(id);
    if (this.scene !== id) return;
    this.jobs = all;
    this.heard.jobs();
  }

  /** What happened while the connection was lost. The light map's stream resumes by itself. */
  private async catchUp(): Promise<void> {
    const { scene } = this;
    if (!scene) return;
    this.events.abort();
    void this.heard.attempt(() => this.listen(scene));
    await this.heard.scene();
  }

  private streamed(event: FromWorker): void {
    switch (event.type) {
      case 'snapshot':
        this.version = event.version;
        this.heard.snapshot(event);
        break;
      case 'offline':
        this.isLost = true;
        banner('The connection is lost. Trying again…', true);
        say('Not connected');
        break;
      case 'online':
        if (this.isLost) {
          banner(null);
          void this.heard.attempt(() => this.catchUp()).then(() => this.heard.attempt(() => this.heard.back()));
        }
        this.isLost = false;
        say('Connected');
        break;
      case 'gone':
        banner('The service no longer has this scene: it was deleted, or the service was started anew. Upload it again.');
        this.heard.deleted();
        break;
      case 'failed': banner(event.why);
    }
  }
}
