// Has what is on the page tell what newly made elements tell, without taking it out of anybody's hands.

/** Fields in which something was typed, or picked, that is not sent yet. */
const typed = new WeakSet<Element>();
const TYPED = ['number', 'text', 'color'];
addEventListener('input', ({ target }) => target instanceof HTMLInputElement && TYPED.includes(target.type) && typed.add(target));
for (const type of ['change', 'focusout']) addEventListener(type, ({ target }) => typed.delete(target as Element));

/** Whether two trees differ in what they tell alone: the same elements, with the same names. */
function isAlike(old: Element, next: Element): boolean {
  if (old.tagName !== next.tagName || old.className !== next.className || old.children.length !== next.children.length) return false;
  if (old.getAttribute('aria-label') !== next.getAttribute('aria-label') || old.getAttribute('type') !== next.getAttribute('type')) return false;
  if (old instanceof HTMLButtonElement && old.textContent !== next.textContent) return false;
  return [...old.children].every((child, k) => isAlike(child, next.children[k]!));
}

function tell(old: Element, next: Element): void {
  if (old instanceof HTMLInputElement) return tellField(old, next as HTMLInputElement);
  if (old instanceof HTMLButtonElement) return void (old.title = (next as HTMLElement).title);
  if (old.children.length === 0 && old.textContent !== next.textContent) old.textContent = next.textContent;
  [...old.children].forEach((child, k) => tell(child, next.children[k]!));
}

function tellField(old: HTMLInputElement, next: HTMLInputElement): void {
  if (typed.has(old)) return;
  Object.assign(old.dataset, next.dataset);
  if (old.defaultValue !== next.defaultValue) old.defaultValue = next.defaultValue;
  if (old.value !== next.value) old.value = next.value;
}

/** Shows parts in place of those that are there; true where those stay and tell the same as these. */
export function show(parent: HTMLElement, parts: HTMLElement[]): boolean {
  const old = [...parent.children];
  if (old.length !== parts.length || !old.every((one, k) => isAlike(one, parts[k]!))) {
    parent.replaceChildren(...parts);
    return false;
  }
  old.forEach((one, k) => tell(one, parts[k]!));
  return true;
}
