type Attributes = Record<string, string>;

/** An element with attributes and children. */
export function make<Name extends keyof HTMLElementTagNameMap>(
  name: Name,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[Name] {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export function button(text: string, action: () => void): HTMLButtonElement {
  const element = make('button', { type: 'button' }, text);
  element.addEventListener('click', action);
  return element;
}

/** A menu of choices with a label; `changed` hears the key that was chosen. */
export function choice<Key extends string>(
  label: string,
  choices: Readonly<Record<Key, string>>,
  chosen: Key,
  changed: (key: Key) => void,
): HTMLElement {
  const keys = Object.keys(choices) as Key[];
  const select = make('select', {}, ...keys.map((key) => make('option', { value: key }, choices[key])));
  select.value = chosen;
  select.addEventListener('change', () => changed(select.value as Key));
  return make('label', {}, make('span', {}, label), select);
}
