// What a step costs and what memory a model takes while most of it rests or is on disk: a world is filled block by
// block as a walk would, through the trainer's own optimizer and world folder, without an engine.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <numeric>
#include <random>
#include <thread>

#include "bench/bench_memory.h"
#include "bench/bench_scene.h"
#include "bus/broker.h"
#include "bus/memory.h"
#include "bus/parameters.h"
#include "trainer/optimizer.h"
#include "trainer/world_bytes.h"
#include "trainer/world_keeper.h"

namespace splatbus::trainer {
namespace {

using Clock = std::chrono::steady_clock;

struct Arguments {
  std::size_t gaussians = 500'000, batch = 50'000;
  double active = 0.05;
  std::size_t device_mb = 0, host_mb = 0, disk_mb = 0;
  int steps = 100, views = 8, size = 512;
  float back = 0.5F, fetch_m = 40, speed = 14, walk_s = 5;
  std::string backend = "cpu", folder;
};

constexpr float kSpacing_m = 0.1F;  // of a Gaussian to its neighbours
constexpr std::size_t kSplits = 64;
constexpr double kWhole = 0.95;  // of what is to be back
constexpr double kPatience_s = 120;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

/// A floor of square blocks, one a batch, row by row and back.
class Floor {
 public:
  explicit Floor(const Arguments& arguments)
      : batch_(arguments.batch),
        edge_m_(kSpacing_m * std::sqrt(static_cast<float>(arguments.batch))),
        blocks_(std::max<std::size_t>(1, arguments.gaussians / arguments.batch)),
        row_(static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(blocks_))))) {}

  [[nodiscard]] std::size_t blocks() const { return blocks_; }
  [[nodiscard]] float edge_m() const { return edge_m_; }
  [[nodiscard]] glm::vec3 centre(std::size_t block) const {
    const std::size_t row = block / row_, at = block % row_, column = row % 2 == 0 ? at : row_ - 1 - at;
    return {edge_m_ * static_cast<float>(column), 0, edge_m_ * static_cast<float>(row)};
  }

  /// In the middle of a row, with that share of the rows before it.
  [[nodiscard]] std::size_t block_at(float share) const {
    const std::size_t rows = (blocks_ + row_ - 1) / row_;
    return std::min(blocks_ - 1, static_cast<std::size_t>(share * static_cast<float>(rows)) * row_ + row_ / 2);
  }
  /// Gaussians that lie within that, as many as were put there.
  [[nodiscard]] double count_near(const glm::vec3& at, float radius_m) const {
    constexpr float kStep_m = 0.5F;
    const auto steps = static_cast<int>(radius_m / kStep_m) + 1;
    double cells = 0;
    for (int i = -steps; i <= steps; ++i) {
      for (int k = -steps; k <= steps; ++k) {
        const float aside = kStep_m * static_cast<float>(i), along = kStep_m * static_cast<float>(k);
        if (std::hypot(aside, along) < radius_m && is_filled(at.x + aside, at.z + along)) ++cells;
      }
    }
    return cells * kStep_m * kStep_m / (kSpacing_m * kSpacing_m);
  }

  [[nodiscard]] InsertBatch fill(std::size_t block, Device device) const {
    std::mt19937 random(static_cast<unsigned>(block));
    std::uniform_real_distribution<float> unit(0, 1);
    std::vector<std::byte> host(insert_rows_bytes(batch_));
    const InsertRows rows = insert_rows_at(host.data(), batch_);
    const auto put = [&](const float* plane, std::size_t channel, std::size_t k, float value) {
      const_cast<float*>(plane)[channel * batch_ + k] = value;
    };
    const glm::vec3 middle = centre(block);
    for (std::size_t k = 0; k < batch_; ++k) {
      put(rows.mean, 0, k, middle.x + edge_m_ * (unit(random) - 0.5F));
      put(rows.mean, 1, k, 0.02F * unit(random));
      put(rows.mean, 2, k, middle.z + edge_m_ * (unit(random) - 0.5F));
      const std::size_t thin = 2;
      for (std::size_t c = 0; c < 3; ++c) {
        put(rows.log_scale, c, k, std::log(kSpacing_m * (c == thin ? 0.1F : 0.5F)));
        put(rows.albedo, c, k, 0.2F + 0.6F * unit(random));
        put(rows.normal, c, k, c == 1 ? 1.0F : 0.0F);
      }
      put(rows.rotation, 0, k, std::sqrt(0.5F));  // z turned up
      put(rows.rotation, 1, k, -std::sqrt(0.5F));
      put(rows.opacity_logit, 0, k, 3);
      put(rows.visibility, 0, k, 1);
    }
    const auto memory = bus::allocate_memory(device, host.size());
    bus::copy_memory(memory.get(), device, host.data(), Device::Cpu, host.size());
    bus::finish_copies();
    return {.epoch = 1,
            .batch = block,
            .count = batch_,
            .memory = memory,
            .rows = insert_rows_at(memory.get(), batch_),
            .scene = {}};
  }

 private:
  [[nodiscard]] bool is_filled(float x, float z) const {
    const float column = std::floor(x / edge_m_ + 0.5F), row = std::floor(z / edge_m_ + 0.5F);
    if (column < 0 || row < 0 || column >= static_cast<float>(row_)) return false;
    const auto c = static_cast<std::size_t>(column), r = static_cast<std::size_t>(row);
    return r * row_ + (r % 2 == 0 ? c : row_ - 1 - c) < blocks_;
  }

  std::size_t batch_;
  float edge_m_;
  std::size_t blocks_, row_;
};

/// A trainer's store, optimizer and, with a folder, its world.
class World {
 public:
  World(const bus::Address& address, const std::string& name, const Arguments& arguments, const std::string& folder)
      : device_(arguments.backend == "cuda" ? Device::Cuda : Device::Cpu) {
    bus::Parameters parameters{bus::Parameters::declare<Options>()};
    const std::pair<const char*, const char*> settings[] = {
        {"freeze_after_s", "3600"}, {"prune", "false"}, {"carve", "false"}, {"albedo_weight", "0"}};
    for (const auto& [key, value] : settings) {
      if (const std::string error = parameters.set(key, value, false); !error.empty()) throw std::runtime_error(error);
    }
    Options options = parameters.read<Options>();
    WorldParameters& world = options.world;
    world.folder = folder;
    world.period_s = 0.05;
    world.device_bytes = arguments.device_mb << 20U;
    world.host_bytes = arguments.host_mb << 20U;
    world.disk_bytes = arguments.disk_mb << 20U;
    world.fetch_m = arguments.fetch_m;
    most_pages_ = folder.empty() ? std::numeric_limits<std::size_t>::max()
                                 : WorldKeeper::most_pages(world, options.layout, device_, 1);
    model::PageStoreOptions store{.max_gaussians = arguments.gaussians + 2 * arguments.batch};
    if (most_pages_ < std::numeric_limits<std::size_t>::max() - kSplits)
      store.max_pages = most_pages_ + kSplits + 2 * arguments.batch / kPageLanes;
    store_ = std::make_unique<model::PageStore>(bus::Context::create(address, name), options.layout, store, device_);
    optimizer_ = std::make_unique<Optimizer>(*store_, options);
    if (!folder.empty()) keeper_ = std::make_unique<WorldKeeper>(*store_, world);
  }

  void insert(InsertBatch batch, const glm::vec3& at) {
    // As an insertion does, which leaves out what finds no room: pages leave until there is an eighth.
    while (keeper_ && store_->page_count() > most_pages_ - most_pages_ / 16) turn(at);
    Commands commands;
    commands.inserts.push_back(std::move(batch));
    optimizer_->apply(commands);
    turn(at);
  }
  void turn(const glm::vec3& at) {
    if (!keeper_) return;
    keeper_->see({{at.x, at.y, at.z}});
    keeper_->turn([this](const auto& change) { optimizer_->restructure(change); });
  }
  /// Freezes what is not within `active`.
  void freeze_beyond(const std::function<bool(const PageBounds&)>& active) {
    std::vector<std::uint32_t> pages;
    const GaussiansView view = store_->view();
    for (std::size_t r = 0; r < view.ranges.size(); ++r) {
      if (!active(view.bounds[r])) pages.push_back(view.ranges[r].first >> kPageShift);
    }
    optimizer_->restructure([&] { store_->freeze(pages); });
  }
  void step(const std::vector<TrainingViewPtr>& views) {
    optimizer_->step(std::span(&views[next_view_++ % views.size()], 1));
  }
  /// Median of the steps' milliseconds, a few at a time.
  double step_ms(const std::vector<TrainingViewPtr>& views, int steps) {
    constexpr int kAtOnce = 10;
    std::vector<double> ms;
    const auto run = [&](int count) {
      const auto begin = Clock::now();
      for (int k = 0; k < count; ++k) step(views);
      static_cast<void>(optimizer_->finish());
      return 1e3 * seconds_since(begin) / count;
    };
    static_cast<void>(run(kAtOnce));
    for (int k = 0; k < steps; k += kAtOnce) ms.push_back(run(kAtOnce));
    return bench::median(ms);
  }

  [[nodiscard]] Device device() const { return device_; }
  [[nodiscard]] model::PageStore& store() { return *store_; }
  [[nodiscard]] WorldKeeper::Stats kept() const { return keeper_ ? keeper_->stats() : WorldKeeper::Stats{}; }
  /// Gaussians of pages whose middle is as near as that.
  [[nodiscard]] std::size_t count_near(const glm::vec3& at, float radius_m) const {
    const GaussiansView view = store_->view();
    std::size_t count = 0;
    for (std::size_t r = 0; r < view.ranges.size(); ++r) {
      const math::Vec3 middle = (view.bounds[r].low + view.bounds[r].high) * 0.5F;
      if (std::hypot(middle.x - at.x, middle.z - at.z) < radius_m) count += view.ranges[r].count;
    }
    return count;
  }

 private:
  Device device_;
  std::size_t most_pages_ = 0, next_view_ = 0;
  std::unique_ptr<model::PageStore> store_;
  std::unique_ptr<Optimizer> optimizer_;
  std::unique_ptr<WorldKeeper> keeper_;
};

/// Pictures of the floor about a point, from above: grey, so that all that shows has something to learn.
std::vector<TrainingViewPtr> views_about(const glm::vec3& at, float side_m, const Arguments& arguments, Device device) {
  std::vector<TrainingViewPtr> views;
  const auto size = static_cast<std::uint32_t>(arguments.size);
  const std::vector<std::uint8_t> grey(std::size_t{4} * size * size, 120);
  const auto memory = bus::allocate_memory(device, grey.size());
  bus::copy_memory(memory.get(), device, grey.data(), Device::Cpu, grey.size());
  bus::finish_copies();
  for (int k = 0; k < arguments.views; ++k) {
    const float angle = 6.2831853F * static_cast<float>(k) / static_cast<float>(arguments.views);
    const glm::vec3 aside(0.2F * side_m * std::cos(angle), 0, 0.2F * side_m * std::sin(angle));
    TrainingView view;
    view.camera = look_at(at + aside + glm::vec3(0.01F, 0.5F * side_m, 0), at + aside, size, size, 1.0F);
    view.camera.id = static_cast<std::uint32_t>(k);
    view.memory = device;
    view.color = {std::shared_ptr<const std::uint8_t>(memory, reinterpret_cast<const std::uint8_t*>(memory.get())),
                  grey.size()};
    views.push_back(std::make_shared<const TrainingView>(std::move(view)));
  }
  return views;
}

void run(const Arguments& arguments, const std::string& folder) {
  bus_service::BrokerOptions broker_options;
  broker_options.address = bus::Address::parse("ipc://" + folder);
  bus_service::Broker broker(broker_options);
  broker.start();
  const Floor floor(arguments);
  const auto active_blocks = std::clamp<std::size_t>(
      static_cast<std::size_t>(std::lround(arguments.active * static_cast<double>(floor.blocks()))), 1, floor.blocks());
  // The nearest to the place that it goes back to.
  std::vector<std::size_t> near(floor.blocks());
  std::iota(near.begin(), near.end(), std::size_t{0});
  const glm::vec3 place = floor.centre(floor.block_at(arguments.back));
  std::stable_sort(near.begin(), near.end(), [&](std::size_t a, std::size_t b) {
    return glm::distance(floor.centre(a), place) < glm::distance(floor.centre(b), place);
  });
  near.resize(active_blocks);
  const float side_m = floor.edge_m() * std::sqrt(static_cast<float>(active_blocks));

  double alone_ms = 0;
  {
    World alone(broker_options.address, "alone", arguments, "");
    for (const std::size_t block : near) alone.insert(floor.fill(block, alone.device()), place);
    alone_ms = alone.step_ms(views_about(place, side_m, arguments, alone.device()), arguments.steps);
    fmt::print("alone: {} Gaussians, {:.2f} ms a step\n", alone.store().count(), alone_ms);
  }

  World world(broker_options.address, "trainer", arguments, folder + "/world");
  const double used_before = bench::used_mib(world.device());
  const auto fill_begin = Clock::now();
  for (std::size_t block = 0; block < floor.blocks(); ++block) {
    world.insert(floor.fill(block, world.device()), floor.centre(block));
  }
  const double fill_s = seconds_since(fill_begin);
  const auto back_begin = Clock::now();
  const float radius_m = std::min(arguments.fetch_m, 0.4F * side_m);
  const auto is_there = [&](const glm::vec3& at) {
    return static_cast<double>(world.count_near(at, radius_m)) / floor.count_near(at, radius_m);
  };
  double longest_ms = 0;  // of the world's turns
  const auto turn = [&](const glm::vec3& at) {
    const auto begin = Clock::now();
    world.turn(at);
    longest_ms = std::max(longest_ms, 1e3 * seconds_since(begin));
  };
  while (is_there(place) < kWhole && seconds_since(back_begin) < kPatience_s) {
    turn(place);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const double back_s = seconds_since(back_begin);
  fmt::print(
      "filled: {} Gaussians here and {} on disk ({:.0f} MB) in {:.1f} s; {:.0f} % of what is within {:.0f} m of"
      " the place is back after {:.2f} s, the world's longest turn {:.1f} ms\n",
      world.store().count(), world.kept().spilled, static_cast<double>(world.kept().disk_bytes) / 1e6, fill_s,
      100 * std::min(is_there(place), 1.0), radius_m, back_s, longest_ms);

  const auto views = views_about(place, side_m, arguments, world.device());
  const double all_ms = world.step_ms(views, arguments.steps);
  const double used_active = bench::used_mib(world.device()) - used_before;
  world.freeze_beyond([&](const PageBounds& bounds) {
    const math::Vec3 at = (bounds.low + bounds.high) * 0.5F;
    return std::max(std::abs(at.x - place.x), std::abs(at.z - place.z)) < 0.5F * side_m;
  });
  const double with_ms = world.step_ms(views, arguments.steps);
  const double used_frozen = bench::used_mib(world.device()) - used_before;
  const auto count = static_cast<double>(world.store().count()),
             frozen = static_cast<double>(world.store().frozen_count());
  fmt::print("step: {:.2f} ms with all active, {:.2f} ms with {:.0f} of {:.0f} frozen: {:.2f} times alone\n", all_ms,
             with_ms, frozen, count, with_ms / alone_ms);
  const double of_active = used_active * 1048576 / count;
  const double of_frozen = of_active - (used_active - used_frozen) * 1048576 / std::max(frozen, 1.0);
  fmt::print(
      "memory: {:.0f} MiB with all active, {:.0f} MiB so; an active Gaussian takes {:.0f} bytes, a frozen one {:.0f}"
      " (the model's own {:.0f})\n",
      used_active, used_frozen, of_active, of_frozen, static_cast<double>(model_bytes(world.store())) / count);

  // Along the way that was filled, with steps between.
  const auto walk_begin = Clock::now();
  double least = 1;
  longest_ms = 0;
  int steps = 0;
  while (seconds_since(walk_begin) < arguments.walk_s) {
    const float along_m = arguments.speed * static_cast<float>(seconds_since(walk_begin));
    const glm::vec3 at = place + glm::vec3(0, 0, -along_m);
    turn(at);
    if (at.z > radius_m) least = std::min(least, is_there(at));
    world.step(views);
    ++steps;
  }
  fmt::print(
      "walk: {:.0f} m/s, at least {:.0f} % of what is within {:.0f} m is here; {:.2f} ms a step, the world's longest"
      " turn {:.1f} ms\n",
      arguments.speed, 100 * std::min(least, 1.0), radius_m, 1e3 * arguments.walk_s / std::max(steps, 1), longest_ms);
}

}  // namespace
}  // namespace splatbus::trainer

int main(int argc, char** argv) {
  splatbus::trainer::Arguments arguments;
  CLI::App app("Steps and memory of a world of which most rests or is on disk");
  app.add_option("--gaussians", arguments.gaussians, "of the world");
  app.add_option("--batch", arguments.batch, "Gaussians an insertion");
  app.add_option("--active", arguments.active, "share that trains");
  app.add_option("--device-mb", arguments.device_mb, "ceiling of device memory, MiB; 0: none");
  app.add_option("--host-mb", arguments.host_mb, "ceiling of host memory, MiB; 0: none");
  app.add_option("--disk-mb", arguments.disk_mb, "ceiling of the folder, MiB; 0: none");
  app.add_option("--steps", arguments.steps, "that are timed");
  app.add_option("--size", arguments.size, "of the pictures, pixels");
  app.add_option("--views", arguments.views, "pictures");
  app.add_option("--back", arguments.back, "where it goes back to, as a share of what is filled: 0 is its beginning")
      ->check(CLI::Range(0.0F, 1.0F));
  app.add_option("--fetch-m", arguments.fetch_m, "what is nearer is not on disk alone");
  app.add_option("--speed", arguments.speed, "of the walk, m/s");
  app.add_option("--walk-s", arguments.walk_s, "of the walk");
  app.add_option("--backend", arguments.backend)->check(CLI::IsMember({"cpu", "cuda"}));
  app.add_option("--folder", arguments.folder, "where the world lies (default: a folder of its own)");
  CLI11_PARSE(app, argc, argv);
  std::string folder = arguments.folder;
  if (folder.empty()) {
    folder = (std::filesystem::temp_directory_path() / "splatbus-bench-XXXXXX").string();
    if (::mkdtemp(folder.data()) == nullptr) return 1;
  }
  splatbus::trainer::run(arguments, folder);
  if (arguments.folder.empty()) std::filesystem::remove_all(folder);
  return 0;
}
