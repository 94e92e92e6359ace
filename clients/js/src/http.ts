// Requests and their refusals.

/** The service said no. The message is its title and detail, for a person to act on. */
export class Refused extends Error {
  override name = 'Refused';
  constructor(
    readonly status: number,
    /** Path of the problem's description, `/problems/…`, or empty. */
    readonly type: string,
    message: string,
    /** The field at fault, where there is one. */
    readonly field: string | null = null,
  ) {
    super(message);
  }
}

/** The service could not be reached; whether it has got the request is not known. */
export class Unreachable extends Error {
  override name = 'Unreachable';
  constructor(cause: unknown) {
    super('The service does not answer.', { cause });
  }
}

export interface ConnectionOptions {
  /** Bearer token. */
  token?: string | null;
  /** Asked for another token where the service wants one; `tried` did not do. Null gives up. */
  askToken?: (tried: string | null) => string | null | Promise<string | null>;
  /** In place of the global one. */
  fetch?: typeof fetch;
}

/** Where a service is, and how one gets in. */
export class Connection {
  readonly base: URL;
  token: string | null;
  private readonly ask: NonNullable<ConnectionOptions['askToken']>;
  private readonly get: typeof fetch;

  constructor(base: string | URL, options: ConnectionOptions = {}) {
    this.base = new URL(base);
    if (!this.base.pathname.endsWith('/')) this.base.pathname += '/';
    this.token = options.token ?? null;
    this.ask = options.askToken ?? (() => null);
    this.get = options.fetch ?? ((input, init) => fetch(input, init));
  }

  url(path: string): string {
    return new URL(path, this.base).href;
  }

  /** Headers that every request carries. */
  get headers(): Record<string, string> {
    return this.token ? { authorization: `Bearer ${this.token}` } : {};
  }

  /** The answer to a request. Throws [Refused] or [Unreachable]; an abort stays what it is. */
  async send(path: string, init: RequestInit = {}): Promise<Response> {
    const tried = this.token;
    let response: Response;
    try {
      response = await this.get(this.url(path), { ...init, headers: { ...(init.headers as object), ...this.headers } });
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new Unreachable(error);
    }
    // 304 is an answer: the caller has asked whether something is new.
    if (response.ok || response.status === 304) return response;
    // Another request may have asked meanwhile.
    if (response.status === 401 && (this.token !== tried || (await this.hasAnother(tried)))) return this.send(path, init);
    throw await refusal(response);
  }

  private async hasAnother(tried: string | null): Promise<boolean> {
    const given = await this.ask(tried);
    if (given === null || given === tried) return false;
    this.token = given;
    return true;
  }
}

async function refusal(response: Response): Promise<Refused> {
  const problem = await response.json().catch(() => ({}));
  const message = [problem.title ?? response.statusText, problem.detail].filter(Boolean).join(': ');
  return new Refused(response.status, problem.type ?? '', message || `status ${response.status}`, problem.field ?? null);
}

/** Waits; an abort ends it early. */
export function pause(ms: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal?.addEventListener('abort', () => (clearTimeout(timer), resolve()), { once: true });
  });
}

/** Milliseconds before the next attempt after so many failures. */
export const delay = (failures: number): number => Math.min(250 * 2 ** failures, 4000);
