// Requests for what is there now: one at a time, so that no older answer comes after a newer one.

/** Runs something, never twice at once: who asks while it runs gets the run that begins after that, together with all who wait. */
export function coalesce(run: () => Promise<void>): () => Promise<void> {
  let last: Promise<void> = Promise.resolve();
  let next: Promise<void> | null = null;
  return () =>
    (next ??= last.then(() => {
      next = null;
      const running = run();
      // How it ends is told to those who asked for it, not to those who come after.
      last = running.catch(() => {});
      return running;
    }));
}
