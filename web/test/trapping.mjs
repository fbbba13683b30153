// Makes the WebAssembly module of a worker trap when a test says so.

/** Before the worker's own script: the function that is named next is called where there is no memory, once. */
const kPrelude = `
{
  const instantiate = WebAssembly.instantiateStreaming;
  WebAssembly.instantiateStreaming = async (...given) => {
    const { instance } = await instantiate(...given);
    let due = null;
    const channel = new BroadcastChannel('trap');
    channel.onmessage = ({ data }) => {
      if (!data.trap) return;
      due = data.trap;
      channel.postMessage('armed');
    };
    const guarded = (name, call) => (...values) => {
      if (due !== name) return call(...values);
      due = null;
      channel.postMessage('trapped');
      return call(...values.map(() => 0xfffffff0));
    };
    const exports = Object.entries(instance.exports).map(([name, value]) => [name, typeof value === 'function' ? guarded(name, value) : value]);
    return { instance: { exports: Object.fromEntries(exports) } };
  };
}
`;

/** To be called before the page is opened. */
export const letTrap = (page, script) =>
  page.route(`**/${script}`, async (route) => {
    const answer = await route.fetch();
    await route.fulfill({ response: answer, body: kPrelude + (await answer.text()) });
  });

/** From now on the next call of this function ends in a trap. Gives what resolves when it has been made. */
export const trapIn = async (page, name) => {
  await page.evaluate(
    (called) =>
      new Promise((armed) => {
        const channel = new BroadcastChannel('trap');
        window.trapped = new Promise((trapped) => {
          channel.onmessage = ({ data }) => {
            if (data === 'armed') armed();
            if (data === 'trapped') trapped(channel.close());
          };
        });
        channel.postMessage({ trap: called });
      }),
    name,
  );
  return () => page.evaluate(() => window.trapped);
};
