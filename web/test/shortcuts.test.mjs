// Which keys shortcuts are on keyboards of many countries, as their makers draw them, rows from left to right.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const { ShortcutKeys, kShortcuts, nameOfShortcut, namesOfKeys } = await import(pathToFileURL(resolve(kPages, 'logic.js')));

const kPlaces = ['QWERTYUIOP', 'ASDFGHJKL', 'ZXCVBNM'].map((row) => [...row].map((letter) => `Key${letter}`));
const kMoving = ['KeyW', 'KeyA', 'KeyS', 'KeyD', 'KeyQ', 'KeyE'];
const layoutOf = (...rows) => new Map(kPlaces.flatMap((places, row) => places.map((code, k) => [code, rows[row][k]])));
const kLayouts = {
  English: layoutOf('qwertyuiop', 'asdfghjkl', 'zxcvbnm'),
  French: layoutOf('azertyuiop', 'qsdfghjkl', 'wxcvbn,'),
  German: layoutOf('qwertzuiop', 'asdfghjkl', 'yxcvbnm'),
  Dvorak: layoutOf("',.pyfgcrl", 'aoeuidhtn', ';qjkxbm'),
  Russian: layoutOf('йцукенгшщз', 'фывапролд', 'ячсмить'),
  Colemak: layoutOf('qwfpgjluy;', 'arstdhnei', 'zxcvbkm'),
  'BÉPO': layoutOf('bépoè^vdlj', 'auie,ctsr', "àyx.k'q"),
  'Turkish F': layoutOf('fgğıodrnhp', 'uieaütkml', 'jövcçzs'),
};
/** Where Latin letters are that are on none of these places. */
const kElsewhere = { French: [['Semicolon', 'm']], Dvorak: [['Period', 'v']], 'BÉPO': [['Semicolon', 'm']] };
const kClashing = ['Colemak', 'BÉPO', 'Turkish F'];
const keysOf = (name) => [...kLayouts[name], ...(kElsewhere[name] ?? [])].map(([code, key]) => ({ code, key }));

for (const name of Object.keys(kLayouts)) {
  test(`${name}: each shortcut is one key, that does not move`, () => {
    for (const told of [true, false]) {
      const shortcuts = new ShortcutKeys();
      // A browser that does not tell is learned from: a person has moved before.
      if (told) shortcuts.learn(kLayouts[name]);
      else for (const code of kMoving) assert.equal(shortcuts.letterOf({ code, key: kLayouts[name].get(code) }), '');
      const found = keysOf(name).map((key) => [shortcuts.letterOf(key), key]).filter(([letter]) => letter);
      assert.deepEqual(found.map(([letter]) => letter).sort(), Object.keys(kShortcuts).sort());
      for (const [letter, { code, key }] of found) {
        assert.ok(!kMoving.includes(code), `${letter} is ${code}`);
        if (kClashing.includes(name)) assert.equal(code, `Key${letter.toUpperCase()}`);
        else if (name !== 'Russian') assert.equal(key, letter, 'what the key says');
      }
      // The menu names each by what is on it, and no key twice.
      const names = found.map(([letter]) => nameOfShortcut(letter.toUpperCase(), kLayouts[name]));
      if (name !== 'Russian') assert.deepEqual(names.map((text) => text.toLowerCase()), found.map(([, { key }]) => key));
      const all = [...names, ...namesOfKeys(kMoving, kLayouts[name]).split(' ')];
      assert.equal(new Set(all).size, all.length, `${all}`);
    }
  });
}

test('another keyboard in place of one whose letters were in the way', () => {
  const shortcuts = new ShortcutKeys();
  shortcuts.learn(kLayouts.Colemak);
  assert.equal(shortcuts.letterOf({ code: 'KeyF', key: 't' }), 'f');
  shortcuts.learn(kLayouts.English);
  assert.equal(shortcuts.letterOf({ code: 'KeyT', key: 't' }), '');
  assert.equal(shortcuts.letterOf({ code: 'KeyF', key: 'f' }), 'f');
});
