#include "explore_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <stdexcept>
#include <utility>

#include "explore_plan.h"
#include "figures.h"
#include "metrics/image_io.h"
#include "parameter_query.h"
#include "private_pipeline.h"
#include "probe_round.h"
#include "process_memory.h"
#include "viewer_watch.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kRoundNs = kSecond;
constexpr std::int64_t kWholeRoundNs = kSecond / 20;    // until the picture after the teleport is whole,
constexpr std::int64_t kHurryNs = 5 * kSecond;          // for so long
constexpr std::int64_t kRoundPatienceNs = 8 * kSecond;  // then those that did not come are given up
constexpr std::int64_t kComparePatienceNs = 2 * kSecond;
constexpr std::int64_t kAnswerPatienceNs = 12 * kSecond;
constexpr std::int64_t kControlNs = kSecond;  // what a viewer was told and does not do yet it is told again
constexpr double kMostStart_s = 120;          // until every viewer shows the start
constexpr double kStartPatience_s = 10;       // from the first pictures on, until they are whole
constexpr double kStartUnmodelled = 0.02, kWholeUnmodelled = 0.01;
constexpr float kAtStart_m = 0.2F;
constexpr int kSheetInstants = 12;
constexpr int kMostAskedAgain = 2;          // for a station whose answer was lost
constexpr std::size_t kStationsARound = 4;  // more of them would keep viewers' own pictures waiting

Inserted inserted_of(const std::map<std::string, double>& counters) {
  const auto count = [&](const char* name) {
    const auto found = counters.find(name);
    return found == counters.end() ? 0 : found->second;
  };
  return {.bare = count("inserted_bare"), .hole = count("inserted_hole"), .fill = count("inserted_fill")};
}

class ExploreRun {
 public:
  ExploreRun(const ExploreRunOptions& options, const std::string& name, const StopSignals& signals,
             const std::function<void(const std::string&)>& show_state)
      : options_(options),
        show_state_(show_state),
        pipeline_(signals, options.setup.out / fmt::format("services_{}.log", name)),
        plan_(plan_exploration(options, pipeline_.address(), pipeline_.folder())),
        viewers_(pipeline_.context()),
        probes_(pipeline_.context(), {}),
        controls_(pipeline_.context()),
        begun_ns_(bus::now_ns()) {
    pipeline_.start(plan_.launch);
    results_.out_s = plan_.ways.front().out_s();
    results_.walk_s = plan_.ways.front().walk_s();
    results_.apart_m = plan_.apart_m;
  }

  ExploreResults run() {
    while (!ready()) step();
    walk_ns_ = bus::now_ns();
    while (time_s() < results_.walk_s + options_.stay_s) {
      tell_to_walk();
      step();
    }
    asking_ = false;
    const std::int64_t end_ns = bus::now_ns() + kAnswerPatienceNs;
    while (!waiting_.empty() && bus::now_ns() < end_ns) step();
    pipeline_.stop();
    return std::move(results_);
  }

 private:
  struct DueStation {
    std::size_t station = 0;
    ExplorePhase phase = ExplorePhase::Out;
    int asked_again = 0;
  };
  /// A probe whose answers have not all come.
  struct Waiting {
    std::uint64_t probe_id = 0;
    std::int64_t asked_ns = 0;
    std::optional<std::size_t> sample;       ///< a viewer's own place,
    std::size_t viewer = 0;                  ///< of this one;
    std::optional<std::size_t> station;      ///< or one that the first viewer left
    ExplorePhase phase = ExplorePhase::Out;  ///< in which the station was due
    int asked_again = 0;
    cv::Mat engine, depth;
  };

  [[nodiscard]] double time_s() const {
    return walk_ns_ == 0 ? 0 : static_cast<double>(bus::now_ns() - walk_ns_) / 1e9;
  }

  /// Every viewer shows the place where it starts, if need be with holes.
  [[nodiscard]] bool ready() {
    const double waited_s = static_cast<double>(bus::now_ns() - begun_ns_) / 1e9;
    if (starts_.size() < plan_.viewers.size()) {
      if (waited_s > kMostStart_s) {
        throw std::runtime_error(
            fmt::format("no viewer showed its start within {} s; see {}", kMostStart_s, pipeline_.log().string()));
      }
      return false;
    }
    if (first_start_ns_ == 0) first_start_ns_ = bus::now_ns();
    const bool whole = std::ranges::all_of(starts_, [](const auto& start) { return start.second <= kStartUnmodelled; });
    return whole || static_cast<double>(bus::now_ns() - first_start_ns_) / 1e9 > kStartPatience_s;
  }

  void tell_to_walk() {
    const std::int64_t now_ns = bus::now_ns();
    const ViewerWatch::Pose* pose = viewers_.pose(plan_.viewers.front());
    const bool walks = pose != nullptr && glm::distance(eye(*pose), plan_.ways.front().start()) > kAtStart_m;
    if (walked_ || now_ns - told_ns_ < kControlNs) return;
    walked_ = walks;
    if (walks) return;
    told_ns_ = now_ns;
    send_control(controls_, "viewer", {{"path_run", "true"}});
  }

  static glm::vec3 eye(const ViewerWatch::Pose& pose) { return pose.camera.world_from_camera.translation; }

  void step() {
    pipeline_.poll(std::chrono::milliseconds(10));
    viewers_.poll(std::chrono::milliseconds(0));
    probes_.poll(std::chrono::milliseconds(0), [this](std::size_t, const ProbePicture& probe) { take(probe); });
    note_jump();
    pass_stations();
    take_answers();
    if (asking_) begin_round();
    // An engine that is slow to answer does not keep the run from being measured.
    if (asking_ && walk_ns_ != 0 && bus::now_ns() - sampled_ns_ > kRoundNs) note_sample();
    if (bus::now_ns() - shown_ns_ < kSecond) return;
    shown_ns_ = bus::now_ns();
    show_state_(state());
  }

  [[nodiscard]] std::string state() const {
    const auto& trainer = pipeline_.state().trainer;
    std::string text = fmt::format("{:.0f}/{:.0f} s {}  {} Gaussians ({} active, {} spilled)", time_s(),
                                   results_.walk_s, walk_ns_ == 0 ? "waits" : to_string(phase()),
                                   trainer.gaussians + trainer.spilled, trainer.active, trainer.spilled);
    const auto sample = std::find_if(results_.samples.rbegin(), results_.samples.rend(),
                                     [](const ExploreSample& s) { return s.viewers.front().has_value(); });
    if (sample == results_.samples.rend()) return text;
    const ViewerFigures& figures = *sample->viewers.front();
    text += fmt::format("  SSIM {:.3f}", figures.ssim);
    if (figures.unmodelled_share) text += fmt::format("  unmodelled {:.1f} %", 100 * *figures.unmodelled_share);
    return text;
  }

  [[nodiscard]] ExplorePhase phase() const { return plan_.ways.front().phase(time_s()); }

  /// When the first viewer was back at its start at once.
  void note_jump() {
    const ViewerWatch::Pose* pose = viewers_.pose(plan_.viewers.front());
    if (jump_ns_ != 0 || walk_ns_ == 0 || pose == nullptr) return;
    if (time_s() < results_.walk_s || glm::distance(eye(*pose), plan_.ways.front().start()) > kAtStart_m) return;
    jump_ns_ = pose->told_ns;
  }

  void pass_stations() {
    const ViewerWatch::Pose* pose = viewers_.pose(plan_.viewers.front());
    if (walk_ns_ == 0 || pose == nullptr) return;
    for (const std::size_t station : results_.stations.pass(phase(), pose->camera)) {
      due_.push_back({.station = station, .phase = phase()});
    }
  }

  void begin_round() {
    const std::int64_t now_ns = bus::now_ns();
    const bool hurried = jump_ns_ != 0 && !results_.teleport_whole_s && now_ns - jump_ns_ < kHurryNs;
    // A new round voids what the engine has not answered of the one before; and a viewer that compares slowly is not
    // asked faster than it answers, or what waits for it would never end.
    const bool drawn = probes_.first_id() == 0 || probes_.complete();
    const std::int64_t patience_ns = !drawn ? kRoundPatienceNs : waiting_.empty() ? 0 : kComparePatienceNs;
    const std::int64_t wait_ns = std::max(patience_ns, hurried ? kWholeRoundNs : kRoundNs);
    if (now_ns - asked_ns_ < wait_ns) return;
    std::vector<Camera> cameras;
    for (const std::string& viewer : plan_.viewers) {
      const ViewerWatch::Pose* pose = viewers_.pose(viewer);
      if (pose == nullptr) return;
      cameras.push_back(pose->camera);
    }
    std::vector<DueStation> stations;
    for (; !due_.empty() && stations.size() < kStationsARound; due_.pop_front()) stations.push_back(due_.front());
    for (const DueStation& due : stations) cameras.push_back(results_.stations.all()[due.station].camera);
    const std::size_t count = cameras.size();
    probes_.begin(std::move(cameras));
    asked_ns_ = now_ns;
    if (walk_ns_ != 0) note_sample();
    for (std::size_t i = 0; i < count; ++i) {
      Waiting waiting{.probe_id = probes_.first_id() + i, .asked_ns = now_ns};
      if (i < plan_.viewers.size()) {
        waiting.viewer = i;
        if (walk_ns_ != 0) waiting.sample = results_.samples.size() - 1;
      } else {
        const DueStation& due = stations[i - plan_.viewers.size()];
        waiting.station = due.station;
        waiting.phase = due.phase;
        waiting.asked_again = due.asked_again;
      }
      waiting_.push_back(std::move(waiting));
    }
  }

  void note_sample() {
    sampled_ns_ = bus::now_ns();
    ExploreSample sample{.time_s = time_s(),
                         .phase = phase(),
                         .eye = eye(*viewers_.pose(plan_.viewers.front())),
                         .trainer = pipeline_.state().trainer,
                         .page_bytes = pipeline_.state().page_bytes,
                         .draw_ms = {},
                         .inserted = {},
                         .viewers = {}};
    sample.viewers.resize(plan_.viewers.size());
    for (const ProcessStatus& process : pipeline_.processes()) {
      if (process.name != "engine" && process.pid != 0)
        sample.resident_bytes += resident_bytes(process.pid).value_or(0);
      if (process.name == "expander") sample.inserted = inserted_of(process.counters);
      if (process.name != plan_.viewers.front()) continue;
      if (const auto drawn = process.counters.find("draw_ms"); drawn != process.counters.end()) {
        sample.draw_ms = drawn->second;
      }
    }
    results_.samples.push_back(std::move(sample));
  }

  void take(const ProbePicture& probe) {
    for (Waiting& waiting : waiting_) {
      if (waiting.probe_id != probe.probe_id) continue;
      waiting.engine = probe.picture;
      waiting.depth = probe.depth;
    }
  }

  void take_answers() {
    std::erase_if(waiting_, [this](const Waiting& waiting) {
      const auto* answer = viewers_.answer(plan_.viewers[waiting.viewer], waiting.probe_id);
      if (answer == nullptr || waiting.engine.empty()) {
        if (bus::now_ns() - waiting.asked_ns <= kAnswerPatienceNs) return false;
        if (waiting.station && waiting.asked_again < kMostAskedAgain) {
          due_.push_back({.station = *waiting.station, .phase = waiting.phase, .asked_again = waiting.asked_again + 1});
        }
        if (waiting.sample) ++(waiting.engine.empty() ? results_.unanswered_by_engine : results_.unanswered_by_viewer);
        return true;
      }
      take(waiting, *answer);
      return true;
    });
  }

  void take(const Waiting& waiting, const ViewerWatch::Answer& answer) {
    if (waiting.station) {
      results_.stations.judge(*waiting.station, waiting.phase, answer.quality.ssim);
      return;
    }
    ViewerFigures figures{.ssim = answer.quality.ssim, .flip = answer.quality.flip, .unmodelled_share = {}};
    if (!waiting.depth.empty()) {
      figures.unmodelled_share = unmodelled_share(viewer_picture(waiting, "alpha"), waiting.depth);
    }
    if (!waiting.sample) {
      starts_[waiting.viewer] = figures.unmodelled_share.value_or(0);
      return;
    }
    ExploreSample& sample = results_.samples[*waiting.sample];
    sample.viewers[waiting.viewer] = figures;
    if (waiting.viewer != 0) return;
    keep_for_sheet(waiting);
    if (jump_ns_ == 0 || results_.teleport_whole_s || waiting.asked_ns < jump_ns_) return;
    if (figures.unmodelled_share.value_or(0) <= kWholeUnmodelled) {
      results_.teleport_whole_s = static_cast<double>(answer.told_ns - jump_ns_) / 1e9;
    }
  }

  void keep_for_sheet(const Waiting& waiting) {
    const double part = results_.samples[*waiting.sample].time_s / (results_.walk_s + options_.stay_s);
    const int instant = static_cast<int>(part * kSheetInstants);
    const auto ssim = [this](const ExplorePictures& of) { return results_.samples[of.sample].viewers.front()->ssim; };
    const ExplorePictures kept{
        .sample = *waiting.sample, .engine = waiting.engine, .viewer = viewer_picture(waiting, "viewer")};
    if (instant > kept_instant_) {
      kept_instant_ = instant;
      results_.pictures.push_back(kept);
      results_.worst.push_back(kept);
    } else if (ssim(kept) < ssim(results_.worst.back())) {
      results_.worst.back() = kept;
    }
  }

  /// What the viewer wrote of a probe before it answered.
  [[nodiscard]] cv::Mat viewer_picture(const Waiting& waiting, const char* kind) const {
    const fs::path folder = pipeline_.folder() / plan_.viewers[waiting.viewer];
    return metrics::read_png(folder / fmt::format("probe_{}_{}.png", waiting.probe_id, kind));
  }

  const ExploreRunOptions& options_;
  const std::function<void(const std::string&)>& show_state_;
  PrivatePipeline pipeline_;
  ExplorePlan plan_;
  ViewerWatch viewers_;
  ProbeRounds probes_;
  bus::Publisher controls_;
  std::deque<Waiting> waiting_;
  std::deque<DueStation> due_;
  std::map<std::size_t, double> starts_;  ///< unmodelled share of a viewer's first place
  ExploreResults results_;
  int kept_instant_ = -1;
  bool asking_ = true, walked_ = false;
  std::int64_t begun_ns_, first_start_ns_ = 0, walk_ns_ = 0, jump_ns_ = 0;
  std::int64_t asked_ns_ = 0, sampled_ns_ = 0, told_ns_ = 0, shown_ns_ = 0;
};

}  // namespace

ExploreResults run_exploration(const ExploreRunOptions& options, const std::string& name, const StopSignals& signals,
                               const std::function<void(const std::string&)>& show_state) {
  return ExploreRun(options, name, signals, show_state).run();
}

}  // namespace splatbus::cli
