// The bearer token of a service that asks for one: asked of the person, kept for this tab.

const KEY = 'rebake-token';
let token = sessionStorage.getItem(KEY);

/** Headers that every call carries. */
export const authorization = (): Record<string, string> => (token ? { authorization: `Bearer ${token}` } : {});

/** Asks for a token where the one that was sent did not do; whether there is another one now. */
export function askAgain(sent: Record<string, string>): boolean {
  // Another call may have asked meanwhile.
  if (authorization()['authorization'] !== sent['authorization']) return true;
  const about = token ? 'The service does not know this token. Another one:' : 'The service asks for a token:';
  const given = prompt(about)?.trim();
  if (!given) return false;
  token = given;
  sessionStorage.setItem(KEY, given);
  return true;
}
