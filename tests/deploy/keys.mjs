// Runs what the exports do with keys before the programs start, on folders as orchestrators make them, and then the
// broker as it is exported: it takes its keys and the bus's folder, or ends.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { chmodSync, copyFileSync, existsSync, lstatSync, mkdirSync, mkdtempSync, readdirSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { setTimeout as wait } from "node:timers/promises";

const user = process.getuid();

/// Two neighbours of one machine.
async function freePorts() {
  const bind = (port) => new Promise((done, fail) => {
    const server = createServer().once("error", fail).listen(port, "127.0.0.1", () => done(server));
  });
  for (;;) {
    const first = await bind(0);
    const port = first.address().port;
    const second = await bind(port + 1).catch(() => undefined);
    first.close();
    second?.close();
    if (second) return port;
  }
}

/// Keys as 'splatbus keys' makes them, under the names that docs/scale.md wants.
function makeSecrets(splatbus, folder) {
  const keys = join(folder, "made");
  mkdirSync(folder);
  for (const name of ["server", "client"]) {
    execFileSync(splatbus, ["keys", "--folder", keys, "new", name, ...(name === "client" ? ["--role", "control"] : [])]);
  }
  const files = { server_key: "server.key", client_key: "client.key", allowed: "allowed" };
  for (const [name, file] of Object.entries(files)) copyFileSync(join(keys, file), join(folder, name));
  writeFileSync(join(folder, "tokens"), "");
}

/// Files behind links, for root and a group.
function asKubernetesMounts(secrets, folder) {
  mkdirSync(join(folder, "..data"), { recursive: true });
  for (const name of ["server_key", "client_key", "allowed", "tokens"]) {
    copyFileSync(join(secrets, name), join(folder, "..data", name));
    chmodSync(join(folder, "..data", name), 0o440);
    symlinkSync(join("..data", name), join(folder, name));
  }
}

function expectPrivate(file, owner) {
  const found = lstatSync(file);
  assert.ok(found.isFile(), `${file} is no file of its own`);
  assert.equal((found.mode & 0o777).toString(8), "600", file);
  assert.equal(found.uid, owner, file);
}

async function brokerRuns(splatbus, command, place) {
  const port = await freePorts();
  const [program, ...words] = command.map((word) => place(word).replace("0.0.0.0:7555", `127.0.0.1:${port}`));
  const broker = spawn(join(dirname(splatbus), program), words, { stdio: ["ignore", "ignore", "pipe"] });
  let said = "";
  broker.stderr.on("data", (text) => { said += text; });
  try {
    for (let attempt = 0; attempt < 100; ++attempt) {
      assert.equal(broker.exitCode, null, said);
      try {
        execFileSync(splatbus, ["health", "--bus", place("ipc:///run/splatbus/bus")], { stdio: "ignore" });
        return;
      } catch {
        await wait(100);
      }
    }
    assert.fail(`no broker answers: ${said}`);
  } finally {
    broker.kill();
  }
}

export async function checkKeys(splatbus, pod, farPod, services) {
  const room = mkdtempSync(join(tmpdir(), "splatbus-keys-"));
  try {
    const secrets = join(room, "secrets");
    makeSecrets(splatbus, secrets);

    // Kubernetes: a folder in memory that is the group's too.
    const run = join(room, "kubernetes"), mounted = join(room, "mounted");
    asKubernetesMounts(secrets, mounted);
    const place = (word) => word.replaceAll("/run/splatbus-secret", mounted).replaceAll("/run/splatbus/", `${run}/`);
    for (const spec of [pod, farPod]) {
      rmSync(run, { recursive: true, force: true });
      mkdirSync(run);
      chmodSync(run, 0o2777);
      const [first] = spec.initContainers;
      assert.deepEqual(first.volumeMounts.map((mount) => mount.mountPath), ["/run/splatbus/keys", "/run/splatbus-secret"]);
      execFileSync(first.command[0], first.command.slice(1).map(place));
      let wanted = 0;
      for (const one of spec.containers) {
        const words = [...one.command, ...(one.env ?? []).map((entry) => entry.value ?? "")];
        const files = new Set(words.flatMap((word) => word.match(/(?<=\/run\/splatbus\/keys\/)\w+/g) ?? []));
        const mount = (one.volumeMounts ?? []).find(({ name }) => name === "keys");
        if (!mount) continue;
        const own = join(run, "keys", mount.subPath);
        assert.equal((lstatSync(own).mode & 0o777).toString(8), "700");
        assert.deepEqual(readdirSync(own).sort(), [...files].sort(), `${one.name} has what it reads, and nothing else`);
        for (const file of files) expectPrivate(join(own, file), user);
        wanted += files.size;
      }
      assert.ok(wanted > 0);
    }
    execFileSync(pod.initContainers[0].command[0], pod.initContainers[0].command.slice(1).map(place));
    await brokerRuns(splatbus, pod.containers[0].command, (word) => place(word).replace(`${run}/keys/`, `${run}/keys/bus/`));

    // Compose: folders in memory that are the user's, and the host's files.
    const folder = join(room, "compose");
    const inCompose = (path) => path.replace("/run/splatbus", folder);
    mkdirSync(folder);
    for (const volume of services.machine.volumes) mkdirSync(inCompose(volume.split(":")[1]), { recursive: true, mode: 0o700 });
    const owner = user === 0 ? 10001 : user;
    const inFolder = (word) => word.replaceAll("/run/secrets", secrets).replaceAll("/run/splatbus/", `${folder}/`)
      .replaceAll("-o 10001 -g 10001", user === 0 ? "-o 10001 -g 10001" : "");
    const [, ...check] = services.machine.healthcheck.test.map(inFolder);
    assert.throws(() => execFileSync(check[0], check.slice(1), { stdio: "ignore" }), "not before they are there");
    const [shell, ...line] = services.machine.command.map(inFolder);
    const machine = spawn(shell, line, { stdio: "ignore" });
    try {
      for (let attempt = 0; attempt < 100 && !existsSync(join(folder, "complete")); ++attempt) await wait(50);
      execFileSync(check[0], check.slice(1));
      assert.equal(machine.exitCode, null, "it stays");
    } finally {
      machine.kill();
    }
    assert.deepEqual(readdirSync(join(folder, "keys/bus")).sort(), ["allowed", "server_key"]);
    assert.deepEqual(readdirSync(join(folder, "keys/gateway")), ["tokens"]);
    for (const name of ["bus/allowed", "bus/server_key", "streamer/server_key", "gateway/tokens"]) {
      expectPrivate(join(folder, "keys", name), owner);
    }
  } finally {
    rmSync(room, { recursive: true, force: true });
  }
}
