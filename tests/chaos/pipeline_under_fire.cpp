#include "pipeline_under_fire.h"

#include <signal.h>

#include <algorithm>
#include <fstream>
#include <iterator>

#include "../hostile/budgets.h"
#include "../integration/pipeline.h"
#include "gateway_url.h"
#include "wire/system_generated.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

constexpr auto kPatience = 120s;
constexpr std::int64_t kSilenceNs = 3'000'000'000;
constexpr std::int64_t kAskAgainNs = 1'500'000'000, kSamplePeriodNs = 500'000'000, kFreshNs = 500'000'000;
constexpr std::size_t kLinesKept = 400;

const std::vector<std::string>& services() {
  static const std::vector<std::string> all{"bus",     "engine",   "capture-bridge", "expander", "trainer",
                                            "relight", "streamer", "viewer",         "gateway"};
  return all;
}

double mean(const std::map<std::size_t, double>& of_view) {
  double sum = 0;
  for (const auto& [view, value] : of_view) sum += value;
  return sum / static_cast<double>(of_view.size());
}

}  // namespace

PipelineUnderFire::PipelineUnderFire() : PipelineUnderFire(cli::Pipeline::launch_file()) {}

PipelineUnderFire::PipelineUnderFire(const std::string& launch_file, int held_out)
    : context_(bus::Context::create(bus_.address(), "chaos-test")),
      watch_(std::make_unique<cli::PipelineWatch>(context_)),
      probes_(std::make_unique<cli::ProbeRounds>(
          context_, cli::circle_cameras({.count = held_out, .size = 64, .phase_degrees = 45}))),
      scene_(std::make_unique<LiveScene>(context_)),
      heartbeats_(
          std::make_unique<bus::Subscriber>(context_, std::vector<std::string>{"sys/heartbeat", "model/published"})) {
  std::ofstream(files_.path() / "chaos.yaml") << launch_file;
  start();
}

void PipelineUnderFire::start() {
  supervisor_ = std::make_unique<cli::ChildProcess>(
      std::string(SPLATBUS_BIN_DIR) + "/splatbus",
      std::vector<std::string>{"launch", (files_.path() / "chaos.yaml").string(), "--bus", bus_.address().text()},
      cli::test_environment());
}

bool PipelineUnderFire::start_again() {
  if (!wait_until([&] { return survivors().empty(); })) return false;
  supervisor_.reset();
  nodes_.clear();
  start();
  return true;
}

std::map<std::string, pid_t> PipelineUnderFire::pids() const {
  std::map<std::string, pid_t> result{{kSupervisor, supervisor_->pid()}};
  for (const auto& [name, node] : nodes_) {
    if (std::ranges::count(services(), name) > 0) result[name] = node.pid;
  }
  return result;
}

void PipelineUnderFire::take_output() {
  (void)supervisor_->poll_exit();
  for (std::string& line : supervisor_->read_lines(false)) {
    log_bytes_ += line.size() + 1;
    last_lines_.push_back(std::move(line));
  }
  if (last_lines_.size() > 2 * kLinesKept) last_lines_.erase(last_lines_.begin(), last_lines_.end() - kLinesKept);
}

void PipelineUnderFire::poll(std::chrono::milliseconds timeout) {
  take_output();
  watch_->poll(timeout);
  scene_->poll(0ms);
  probes_->poll(0ms, [](std::size_t, const cli::ProbePicture&) {});
  take_sample();
  while (const auto message = heartbeats_->receive(0ms)) {
    if (message->topic() == "model/published") {
      model_epoch_ = message->header().epoch();
      continue;
    }
    if (message->header().resent()) continue;  // of who may be gone
    const auto& heartbeat = message->root<wire::Heartbeat>();
    const std::string source = message->header().source()->str();
    Node& node = nodes_[source];
    node = {.pid = static_cast<pid_t>(heartbeat.pid()),
            .heard_ns = bus::now_ns(),
            .runs = heartbeat.state() == wire::ServiceState::Running,
            .heard = {}};
    if (heartbeat.backend() != nullptr) node.heard.backend = heartbeat.backend()->str();
    if (heartbeat.counters() == nullptr) continue;
    for (const auto* counter : *heartbeat.counters()) node.heard.counters[counter->name()->str()] = counter->value();
    if (source == "bus" && node.heard.counters.contains("slabs")) slabs_ = node.heard.counters.at("slabs");
  }
}

void PipelineUnderFire::take_sample() {
  if (!sampling_) return;
  const std::int64_t now = bus::now_ns();
  const auto& pictures = state().viewer_quality;
  for (auto picture = pictures.upper_bound(newest_sample_); picture != pictures.end(); ++picture) {
    newest_sample_ = picture->first;
    newest_ssim_[probes_->camera_of(picture->first).value_or(0)] = picture->second.ssim;
    samples_.push_back({now, picture->second.ssim, mean(newest_ssim_)});
  }
  if (now - sampled_ns_ < kSamplePeriodNs) return;
  sampled_ns_ = now;
  probes_->begin();
}

cli::ChildProcess PipelineUnderFire::begin(std::vector<std::string> verb) const {
  verb.insert(verb.end(), {"--bus", bus_.address().text()});
  return {std::string(SPLATBUS_BIN_DIR) + "/splatbus", verb, cli::test_environment()};
}

cli::Answer PipelineUnderFire::operate(std::vector<std::string> verb) {
  cli::ChildProcess command = begin(std::move(verb));
  cli::Answer answer{.status = {.code = -1}, .lines = {}};
  (void)wait_until([&] {
    const auto status = command.poll_exit();
    for (std::string& line : command.read_lines(status.has_value())) answer.lines.push_back(std::move(line));
    if (status) answer.status = *status;
    return status.has_value();
  });
  return answer;
}

pid_t PipelineUnderFire::successor_of(const std::string& name) const {
  const auto node = nodes_.find(name + ".next");
  const bool is_there = node != nodes_.end() && bus::now_ns() - node->second.heard_ns < kFreshNs;
  return is_there ? node->second.pid : 0;
}

bool PipelineUnderFire::wait_until(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    poll(20ms);
  }
  return true;
}

void PipelineUnderFire::let_pass(std::chrono::milliseconds time) {
  const auto end = std::chrono::steady_clock::now() + time;
  while (std::chrono::steady_clock::now() < end) poll(20ms);
}

bool PipelineUnderFire::all_alive(const std::map<std::string, pid_t>& killed) const {
  return std::ranges::all_of(services(), [&](const std::string& name) {
    const auto node = nodes_.find(name);
    if (node == nodes_.end() || !node->second.runs) return false;
    if (bus::now_ns() - node->second.heard_ns > kSilenceNs) return false;
    const auto was = killed.find(name);
    return was == killed.end() || was->second != node->second.pid;
  });
}

bool PipelineUnderFire::wait_until_well(double ssim, const std::map<std::string, pid_t>& killed) {
  std::int64_t asked_ns = 0;
  std::uint64_t first_id = 0;
  return wait_until([&] {
    if (!all_alive(killed)) return false;
    std::map<std::size_t, double> newest;
    for (const auto& [probe_id, quality] : state().viewer_quality) {
      if (first_id == 0 || probe_id < first_id) continue;
      if (const auto view = probes_->camera_of(probe_id)) newest[*view] = quality.ssim;
    }
    if (newest.size() == probes_->cameras().size() && mean(newest) >= ssim) {
      ssim_ = mean(newest);
      return true;
    }
    if (bus::now_ns() - asked_ns > kAskAgainNs) {
      asked_ns = bus::now_ns();
      if (!sampling_ || first_id == 0) probes_->begin();
      if (first_id == 0) first_id = probes_->first_id();
    }
    return false;
  });
}

Usage PipelineUnderFire::usage() const {
  Usage usage{.slabs = slabs_};
  for (const auto& [name, pid] : pids()) {
    usage.resident_bytes[name] = hostile::resident_bytes(pid);
    usage.descriptors[name] = hostile::open_descriptors(pid);
  }
  for (const auto& entry : std::filesystem::directory_iterator(bus_.path())) {
    usage.files.insert(entry.path().filename().string());
  }
  return usage;
}

std::optional<std::vector<std::uint64_t>> PipelineUnderFire::gaussian_ids() {
  std::optional<std::vector<std::uint64_t>> ids;
  (void)wait_until([&] {
    const std::optional<GaussiansBuffer> model = scene_->copy_average(1000ms);
    if (!model) return false;
    ids.emplace(model->gaussian_id.begin(), model->gaussian_id.begin() + static_cast<std::ptrdiff_t>(model->count()));
    return true;
  });
  return ids;
}

std::string PipelineUnderFire::log() const {
  std::string text;
  const std::size_t first = last_lines_.size() > kLinesKept ? last_lines_.size() - kLinesKept : 0;
  for (std::size_t i = first; i < last_lines_.size(); ++i) text += last_lines_[i] + "\n";
  return text;
}

std::set<std::string> PipelineUnderFire::survivors() const {
  std::set<std::string> found;
  const std::string folder = bus_.path().string();
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::ifstream file(entry.path() / "cmdline", std::ios::binary);
    const std::string command{std::istreambuf_iterator<char>(file), {}};
    if (command.find(folder) != std::string::npos) found.insert(entry.path().filename().string() + " " + command);
  }
  return found;
}

std::set<std::string> PipelineUnderFire::stop() {
  ::kill(supervisor_->pid(), SIGTERM);
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!survivors().empty() && std::chrono::steady_clock::now() < end) poll(50ms);
  return survivors();
}

}  // namespace splatbus::chaos
