// What a tick of the streamer takes of a large model of which most rests: observing it, and what is sent of it.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <vector>

#include "bus/clock.h"
#include "stream/stream_model.h"

namespace splatbus::bench {

namespace {

struct Options {
  std::size_t gaussians = 1'000'000;
  double active = 0.1;
  std::size_t inserted = 500;
  int ticks = 40;
  double budget_kbps = 6000, tick_hz = 5;
  float moves = 0.002F;
};

/// CPU time of the calling thread would not have what TBB's workers do.
double cpu_ms() {
  return static_cast<double>(bus::process_cpu_ns()) / 1e6;
}
double wall_ms() {
  return static_cast<double>(bus::now_ns()) / 1e6;
}

/// Gaussians of a plain, three quarters of each page full; the last pages are trained, and grow.
class Plain {
 public:
  explicit Plain(const Options& options) {
    constexpr std::uint32_t kFill = kPageLanes * 3 / 4;
    while (count_ < options.gaussians) add_page(kFill);
    const auto active = static_cast<std::size_t>(std::ceil(options.active * static_cast<double>(ranges_.size())));
    resting_ = ranges_.size() - std::clamp<std::size_t>(active, 1, ranges_.size());
    for (std::size_t k = 0; k < resting_; ++k) ranges_[k].frozen = 1;
  }

  void train(float amount) {
    std::normal_distribution<float> normal(0, amount);
    for (std::size_t k = resting_; k < ranges_.size(); ++k) {
      for (std::size_t c = 0; c < kChannels; ++c) {
        float* const row = row_of(k, c);
        for (std::uint32_t lane = 0; lane < ranges_[k].count; ++lane) row[lane] += normal(random_);
      }
    }
  }
  void insert(std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      if (ranges_.back().count == kPageLanes) add_page(0);
      put(ranges_.size() - 1);
    }
  }
  [[nodiscard]] GaussiansView view() const {
    GaussiansView out;
    out.count = ranges_.size() * kPageLanes;
    out.stride = kPageLanes;
    out.page_shift = kPageShift;
    out.page_stride = kPageFloats;
    out.ranges = ranges_;
    out.bounds = bounds_;
    out.generations = generations_;
    out.parameters = memory_.data();
    out.normal = memory_.data() + kChannels * kPageLanes;
    out.visibility = out.normal + std::size_t{3} * kPageLanes;
    out.gaussian_id = reinterpret_cast<const std::uint64_t*>(out.visibility + kPageLanes);
    return out;
  }
  [[nodiscard]] std::size_t count() const { return count_; }

 private:
  static constexpr std::size_t kChannels = ParameterLayout{}.channels();
  static constexpr std::size_t kPageFloats = (kChannels + 6) * kPageLanes;

  float* row_of(std::size_t page, std::size_t row) { return memory_.data() + page * kPageFloats + row * kPageLanes; }
  void add_page(std::uint32_t count) {
    const std::size_t page = ranges_.size();
    const auto x = static_cast<float>(page % 64), z = static_cast<float>(page / 64);
    memory_.resize(memory_.size() + kPageFloats);
    generations_.push_back(1);
    ranges_.push_back({.first = static_cast<std::uint32_t>(page) * kPageLanes, .count = 0});
    bounds_.push_back({.low = {x, 0, z}, .high = {x + 1, 1, z + 1}, .max_scale_m = 0.05F});
    while (ranges_[page].count < count) put(page);
  }
  void put(std::size_t page) {
    std::uniform_real_distribution<float> unit(0, 1);
    const std::uint32_t lane = ranges_[page].count++;
    const auto set = [&](std::size_t row, float value) { row_of(page, row)[lane] = value; };
    for (std::size_t c = 0; c < kChannels; ++c) set(c, 0.2F * unit(random_));
    set(0, bounds_[page].low.x + unit(random_));
    set(2, bounds_[page].low.z + unit(random_));
    for (std::size_t axis = 0; axis < 3; ++axis) set(ParameterLayout::kLogScale + axis, -5 + unit(random_));
    set(ParameterLayout::kRotation, 1);
    set(kChannels + 1, 1);
    set(kChannels + 3, 1);
    const std::uint64_t id = ++count_;
    std::memcpy(row_of(page, kChannels + 4) + std::size_t{2} * lane, &id, sizeof id);
  }

  std::mt19937 random_{1};
  std::vector<float> memory_;  ///< [pages][parameters, normal, visibility, ids]
  std::vector<IndexRange> ranges_;
  std::vector<std::uint64_t> generations_;
  std::vector<PageBounds> bounds_;
  std::size_t count_ = 0, resting_ = 0;
};

void run(const Options& options) {
  Plain plain(options);
  stream::StreamModel model(stream::PacketWriter("streamer", 1), 1);
  (void)model.observe(plain.view());
  model.reset_to_target();
  // Until what rests has calmed down.
  std::vector<double> observe_ms, tick_ms, all_cpu_ms;
  for (int tick = 0; tick < 40 + options.ticks; ++tick) {
    plain.train(options.moves);
    plain.insert(options.inserted);
    const double begin = wall_ms(), begin_cpu = cpu_ms();
    (void)model.observe(plain.view());
    const double observed = wall_ms();
    model.make_tick(options.budget_kbps * 125 / options.tick_hz, {});
    const double ticked = wall_ms(), ticked_cpu = cpu_ms();
    (void)model.take_update();
    if (tick < 40) continue;
    observe_ms.push_back(observed - begin);
    tick_ms.push_back(ticked - observed);
    all_cpu_ms.push_back(ticked_cpu - begin_cpu);
  }
  const auto middle = [](std::vector<double>& values) {
    std::ranges::nth_element(values, values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2));
    return values[values.size() / 2];
  };
  fmt::print(
      "{} Gaussians, {:.0f} % active, {} more a tick: observing {:.1f} ms, the tick {:.1f} ms, both {:.1f} ms "
      "of all cores' time; {} read, {} pages looked through\n",
      plain.count(), 100 * options.active, options.inserted, middle(observe_ms), middle(tick_ms), middle(all_cpu_ms),
      model.read_count(), model.busy_pages());
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("A tick of the streamer: the medians");
  app.add_option("--gaussians", options.gaussians, "at the start");
  app.add_option("--active", options.active, "share of the pages that are trained; the others are frozen")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--inserted", options.inserted, "new Gaussians a tick");
  app.add_option("--ticks", options.ticks, "measured, after 40 that are not")->check(CLI::Range(1, 100000));
  app.add_option("--budget-kbps", options.budget_kbps, "of deltas");
  app.add_option("--tick-hz", options.tick_hz, "ticks a second");
  app.add_option("--moves", options.moves, "deviation of what a tick adds to each parameter of what is active");
  CLI11_PARSE(app, argc, argv);
  splatbus::bench::run(options);
  return 0;
}
