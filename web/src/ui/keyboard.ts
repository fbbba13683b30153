// What keys say, which their places do not tell on every layout.

/** Not in every browser, and so not in the DOM's types. */
interface KeyboardApi {
  getLayoutMap(): Promise<ReadonlyMap<string, string>>;
}

/** The Latin letter on a key; where it has another script, the one that is there besides; '' for what is none. */
export function letterOf({ key, code }: Pick<KeyboardEvent, 'key' | 'code'>): string {
  const said = key.length === 1 && key < '\x80' ? key : /^Key(.)$/.exec(code)?.[1];
  return said?.toLowerCase() ?? '';
}

/** What keys at these places, as 'KeyW', say on this keyboard; where the browser does not know, as on an English one. */
export async function namesOfKeys(codes: readonly string[]): Promise<string> {
  const { keyboard } = navigator as { keyboard?: KeyboardApi };
  const layout = await keyboard?.getLayoutMap().catch(() => null);
  return codes.map((code) => (layout?.get(code) ?? code.slice(3)).toUpperCase()).join(' ');
}
