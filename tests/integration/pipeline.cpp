#include "pipeline.h"

#include <fstream>
#include <sstream>

#include "gateway_url.h"
#include "launch_plan.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::seconds kPatience(90);
constexpr std::int64_t kAskAgainNs = 1'500'000'000;

LaunchPlan plan(const std::string& text, const bus::Address& address, std::string& url) {
  LaunchFile file = parse_launch_file(text, "pipeline.yaml");
  url = settle_gateway(file, 0)->url;
  return plan_launch(file, address, SPLATBUS_BIN_DIR);
}

}  // namespace

std::string Pipeline::launch_file() {
  // Timeouts are long: sanitizers and busy machines are slow, and no test waits for one.
  return R"(
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--fps, "10"]
  - name: capture-bridge
    parameters:
      reference_rig: ring
      reference_cameras: 4
      reference_size: 64
      reference_rate_hz: 2
      input_cameras: 8
      input_size: 64
      sample_budget: 4000
      light_depth_size: 128
  - name: expander
  - name: trainer
    parameters: {threads: 1, max_gaussians: 8192}
  - name: relight
  - name: streamer
  - name: viewer
    parameters: {probe: true, probe_period_s: 0, threads: 1, width: 64, height: 64}
  - name: gateway
)";
}

Pipeline::Pipeline(const std::string& launch_file)
    : context_(bus::Context::create(folder_.address(), "pipeline-test")),
      watch_(context_),
      probes_(context_, circle_cameras({.count = 1, .size = 64, .phase_degrees = 45})),
      run_(plan(launch_file, folder_.address(), url_), folder_.path() / "services.log") {}

std::map<std::string, pid_t> Pipeline::pids() const {
  std::map<std::string, pid_t> result;
  for (const ProcessStatus& process : run_.status()) result[process.name] = process.pid;
  return result;
}

ProcessStatus Pipeline::status(const std::string& name) const {
  for (const ProcessStatus& process : run_.status()) {
    if (process.name == name) return process;
  }
  return {};
}

bool Pipeline::wait_until(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    watch_.poll(std::chrono::milliseconds(20));
    probes_.poll(std::chrono::milliseconds(0), [](std::size_t, const ProbePicture&) {});
  }
  return true;
}

bool Pipeline::wait_for_picture(double ssim) {
  std::int64_t asked_ns = 0;
  std::uint64_t first_id = 0;
  return wait_until([&] {
    for (const auto& [probe_id, quality] : state().viewer_quality) {
      if (first_id != 0 && probe_id >= first_id && quality.ssim >= ssim) return true;
    }
    if (bus::now_ns() - asked_ns > kAskAgainNs) {
      asked_ns = bus::now_ns();
      probes_.begin();
      if (first_id == 0) first_id = probes_.first_id();
    }
    return false;
  });
}

std::uint16_t Pipeline::gateway_port() const {
  return static_cast<std::uint16_t>(std::stoi(url_.substr(url_.rfind(':') + 1)));
}

std::string Pipeline::log() const {
  std::ifstream file(folder_.path() / "services.log");
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

}  // namespace splatbus::cli
