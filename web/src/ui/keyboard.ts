// What keys say, which their places do not tell on every layout.
import type { Key } from '../camera/keys';

/** What keys say by where they are, as 'KeyW'. */
export type Layout = ReadonlyMap<string, string>;

/** Not in every browser, and so not in the DOM's types. */
interface KeyboardApi {
  getLayoutMap(): Promise<Layout>;
}

/** Of the keyboard that there is now; null where the browser does not tell. */
export async function layoutHere(): Promise<Layout | null> {
  const { keyboard } = navigator as { keyboard?: KeyboardApi };
  return (await keyboard?.getLayoutMap().catch(() => null)) ?? null;
}

/** What a key at that place says on an English keyboard, where that is a letter; else ''. */
export function latinOf(code: string): string {
  return /^Key(.)$/.exec(code)?.[1].toLowerCase() ?? '';
}

/** The Latin letter on a key; where it has another script, the one that is there besides; '' for what is none. */
export function letterOf({ key, code }: Key): string {
  return key.length === 1 && key < '\x80' ? key.toLowerCase() : latinOf(code);
}

/** In capitals, but for what would be another letter then, as the dotless i. */
export function capitalOf(letter: string): string {
  const capital = letter.toUpperCase();
  return capital.toLowerCase() === letter.toLowerCase() ? capital : letter;
}

/** What keys at these places say; where nobody knows, as on an English keyboard. */
export function namesOfKeys(codes: readonly string[], layout: Layout | null): string {
  return codes.map((code) => capitalOf(layout?.get(code) ?? code.slice(3))).join(' ');
}
