// Stated error against time, both logarithmic: a bake that converges is a straight line.

interface Sample {
  seconds: number;
  error: number;
}

export class Plot {
  private jobs: { id: string; samples: Sample[] }[] = [];

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.draw();
  }

  add(job: string, seconds: number, error: number): void {
    let line = this.jobs.find((j) => j.id === job);
    if (!line) {
      line = { id: job, samples: [] };
      this.jobs = [...this.jobs.slice(-4), line];
    }
    const last = line.samples.at(-1);
    if (seconds <= 0 || error <= 0 || (last && last.error === error)) return;
    line.samples.push({ seconds, error });
    this.draw();
  }

  clear(): void {
    this.jobs = [];
    this.draw();
  }

  private draw(): void {
    const context = this.canvas.getContext('2d')!;
    const { width, height } = this.canvas;
    context.clearRect(0, 0, width, height);
    context.font = '11px system-ui, sans-serif';
    context.fillStyle = '#b4bac6';
    const all = this.jobs.flatMap((j) => j.samples);
    if (all.length === 0) {
      context.fillText('no work yet', 10, 20);
      return;
    }
    const range = (values: number[]) => [Math.min(...values) / 1.2, Math.max(...values) * 1.2] as const;
    const [t0, t1] = range(all.map((s) => s.seconds));
    const [e0, e1] = range(all.map((s) => s.error));
    const [left, right, top, bottom] = [44, width - 8, 8, height - 20];
    const x = (t: number) => left + ((right - left) * Math.log(t / t0)) / Math.log(t1 / t0);
    const y = (e: number) => bottom - ((bottom - top) * Math.log(e / e0)) / Math.log(e1 / e0);
    context.strokeStyle = '#3a3f4b';
    context.strokeRect(left, top, right - left, bottom - top);
    context.fillText(e1.toPrecision(2), 4, top + 10);
    context.fillText(e0.toPrecision(2), 4, bottom);
    context.fillText(`${t0.toPrecision(2)} s`, left, height - 5);
    context.textAlign = 'right';
    context.fillText(`${t1.toPrecision(2)} s`, right, height - 5);
    context.textAlign = 'left';
    this.jobs.forEach(({ samples }, i) => {
      const isNewest = i === this.jobs.length - 1;
      context.strokeStyle = context.fillStyle = isNewest ? '#7cc4ff' : '#6b7280';
      context.lineWidth = isNewest ? 2 : 1;
      context.beginPath();
      samples.forEach((s, k) => (k ? context.lineTo(x(s.seconds), y(s.error)) : context.moveTo(x(s.seconds), y(s.error))));
      context.stroke();
      for (const s of samples) context.fillRect(x(s.seconds) - 2, y(s.error) - 2, 4, 4);
    });
  }
}
