// What is selected: objects and lights, what was chosen last at the end.

export interface Picked {
  kind: 'object' | 'light';
  name: string;
}

export const isSame = (one: Picked, other: Picked) => one.kind === other.kind && one.name === other.name;

export class Selection {
  all: readonly Picked[] = [];

  get last(): Picked | null {
    return this.all.at(-1) ?? null;
  }

  /** Names of one kind, in the order in which they were chosen. */
  names(kind: Picked['kind']): string[] {
    return this.all.filter((one) => one.kind === kind).map(({ name }) => name);
  }

  /** Selects these alone; with `isMore` each of them beside what is selected, or no more where all of them are. */
  choose(next: readonly Picked[], isMore = false): void {
    const others = this.all.filter((one) => !next.some((other) => isSame(one, other)));
    const areAll = others.length + next.length === this.all.length;
    this.all = !isMore ? next : areAll ? others : [...others, ...next];
  }

  /** Lets go of what is no more. */
  keep(is: (one: Picked) => boolean): void {
    this.all = this.all.filter(is);
  }
}
