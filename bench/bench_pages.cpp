// How long an insertion takes while a model in pages grows. The size of a page is a constant of the build
// (-DSPLATBUS_PAGE_SHIFT=9 to 12), how full a split leaves it an option.
#include <fmt/format.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <random>

#include "bus/broker.h"
#include "device/buffer.h"
#include "model/page_store.h"

namespace splatbus::model {

namespace {

struct Options {
  std::size_t gaussians = 5'000'000, batch = 50'000;
  float fill = 0.75F;
  bool walk = false;
  Device device = Device::Cpu;
};

double now_ms(clockid_t clock) {
  timespec time{};
  ::clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) * 1e3 + static_cast<double>(time.tv_nsec) / 1e6;
}

/// Rows whose means are all over a floor of 100 m, or in and around the room that a walk has come to; all else is the
/// same.
class Rows {
 public:
  Rows(const Options& options) : options_(options), stream_(options.device), floats_(stream_), object_id_(stream_) {
    host_.resize(kPlanes * options.batch, 0.5F);
    floats_.resize(host_.size());
    object_id_.resize(options.batch);
    object_id_.clear();
  }
  InsertRows next(std::size_t round) {
    constexpr float kSide_m = 100, kRoom_m = 4, kHeight_m = 3;
    std::uniform_real_distribution<float> unit(0, 1);
    // From room to room, row by row.
    constexpr std::size_t kRow = 10;
    const float at[2] = {kRoom_m * static_cast<float>(round % kRow), kRoom_m * static_cast<float>(round / kRow)};
    for (std::size_t k = 0; k < options_.batch; ++k) {
      const auto across = [&](int axis) {
        return options_.walk ? at[axis] + 1.2F * kRoom_m * (unit(random_) - 0.5F) : kSide_m * (unit(random_) - 0.5F);
      };
      host_[k] = across(0);
      host_[options_.batch + k] = kHeight_m * unit(random_);
      host_[2 * options_.batch + k] = across(1);
    }
    floats_.assign(std::span(std::as_const(host_)));
    stream_.wait();
    std::size_t plane = 0;
    const auto take = [&](std::size_t channels) {
      const float* const at_plane = floats_.data() + plane * options_.batch;
      plane += channels;
      return at_plane;
    };
    InsertRows rows{.stride = options_.batch};
    rows.mean = take(3);
    rows.log_scale = take(3);
    rows.rotation = take(4);
    rows.opacity_logit = take(1);
    rows.albedo = take(3);
    rows.normal = take(3);
    rows.visibility = take(1);
    rows.object_id = object_id_.data();
    return rows;
  }

 private:
  static constexpr std::size_t kPlanes = 18;
  Options options_;
  std::mt19937 random_{5};
  std::vector<float> host_;
  device::Stream stream_;
  device::Buffer<float> floats_;
  device::Buffer<std::uint32_t> object_id_;
};

void run(const Options& options, const std::string& folder) {
  bus_service::BrokerOptions broker_options;
  broker_options.address = bus::Address::parse("ipc://" + folder);
  bus_service::Broker broker(broker_options);
  broker.start();
  PageStore store(bus::Context::create(broker_options.address, "trainer"), {},
                  {.max_gaussians = options.gaussians, .fill = options.fill}, options.device);
  Rows rows(options);
  const std::size_t rounds = options.gaussians / options.batch;
  std::vector<double> ms, cpu_ms, written_mb;
  for (std::size_t round = 0; round < rounds; ++round) {
    const InsertRows batch = rows.next(round);
    const std::uint64_t written = store.written_bytes();
    const double begin = now_ms(CLOCK_MONOTONIC), cpu_begin = now_ms(CLOCK_PROCESS_CPUTIME_ID);
    store.insert(batch, options.batch, {}, 1, round);
    ms.push_back(now_ms(CLOCK_MONOTONIC) - begin);
    cpu_ms.push_back(now_ms(CLOCK_PROCESS_CPUTIME_ID) - cpu_begin);
    written_mb.push_back(static_cast<double>(store.written_bytes() - written) / 1e6);
  }
  const auto middle = [](std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
    return values[values.size() / 2];
  };
  const std::size_t tenth = std::max<std::size_t>(1, rounds / 10);
  const auto part = [&](const std::vector<double>& of, std::size_t k) {
    const auto first = of.begin() + static_cast<std::ptrdiff_t>(k * tenth);
    return middle({first, first + static_cast<std::ptrdiff_t>(tenth)});
  };
  const double begin = now_ms(CLOCK_MONOTONIC);
  store.refresh_bounds();
  const double bounds_ms = now_ms(CLOCK_MONOTONIC) - begin;
  double extent_m = 0;
  for (const PageBounds& box : store.view().bounds) extent_m += math::length(box.high - box.low);
  fmt::print("{} lanes, fill {:.2f}, {}, {}: first {:.1f} ms (CPU {:.1f}), worst {:.1f} ms\n", kPageLanes, options.fill,
             options.walk ? "walk" : "spread", name_of(options.device), ms.front(), cpu_ms.front(),
             *std::max_element(ms.begin(), ms.end()));
  for (const std::size_t k : {0, 3, 6, 9}) {
    fmt::print("  tenth {}: {:.1f} ms (CPU {:.1f}), {:.2f} of the first (CPU {:.2f}), {:.0f} MB written\n", k + 1,
               part(ms, k), part(cpu_ms, k), part(ms, k) / ms.front(), part(cpu_ms, k) / cpu_ms.front(),
               part(written_mb, k));
  }
  fmt::print("  {} pages, {:.0f}% full, {:.2f} m across; bounds of all {:.1f} ms\n", store.page_count(),
             100.0 * static_cast<double>(store.count()) / static_cast<double>(store.page_count() * kPageLanes),
             extent_m / static_cast<double>(store.page_count()), bounds_ms);
}

}  // namespace

}  // namespace splatbus::model

int main(int argc, char** argv) {
  splatbus::model::Options options;
  bool cuda = false;
  CLI::App app("Time of insertions while a model in pages grows");
  app.add_option("--gaussians", options.gaussians, "size that the model grows to");
  app.add_option("--batch", options.batch, "Gaussians an insertion");
  app.add_option("--fill", options.fill, "how full a split leaves pages");
  app.add_flag("--walk", options.walk, "insert where a walk is by now, not all over");
  app.add_flag("--cuda", cuda, "keep the model in device memory");
  CLI11_PARSE(app, argc, argv);
  if (cuda) options.device = splatbus::Device::Cuda;
  std::string folder = (std::filesystem::temp_directory_path() / "splatbus-bench-XXXXXX").string();
  if (::mkdtemp(folder.data()) == nullptr) return 1;
  splatbus::model::run(options, folder);
  std::filesystem::remove_all(folder);
  return 0;
}
