#pragma once

#include <cstdint>
#include <future>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bus/address.h"
#include "bus_watch.h"
#include "gpu_usage.h"

namespace splatbus::cli {

/// A row of `splatbus top`. What cannot be known here (no supervisor, a bus on another machine, no GPU) is missing.
struct TopService {
  std::string name, state, backend, detail;
  std::uint32_t pid = 0;
  bool alive = false;
  std::optional<int> restarts;
  std::optional<double> processor_percent;        ///< of one core, since the view before
  std::optional<double> memory_bytes, gpu_bytes;  ///< the former as own_bytes()
  double rate_hz = 0;                             ///< messages that it publishes, of all topics
  double drops = 0;                               ///< since it started: drops_of()
};

struct TopTopic {
  std::string name;
  TopicTraffic traffic;
  std::size_t readers = 0;
};

/// All that `splatbus top` shows at one time.
struct TopView {
  std::string bus;
  double interval_s = 0;  ///< that rates are of; 0 before there are any
  std::vector<TopService> services;
  std::vector<TopTopic> topics;  ///< in the order of a frame's way: by age; those without one last
  std::vector<GpuUsage> gpus;
};

enum class TopOrder : std::uint8_t { Name, Processor, Memory, Rate, Drops };

/// Rates and loads from what the bus says and the kernel counts: it subscribes to the broker's own topics and to
/// heartbeats, and so no payload comes here. One thread.
class TopSampler {
 public:
  TopSampler(std::shared_ptr<bus::Context> context, bus::Address address);
  /// Follows the bus for so long.
  void follow(std::chrono::milliseconds time) { watch_.follow(time); }
  [[nodiscard]] bool started() const { return watch_.complete(); }
  /// Whether a view has rates: the broker has spoken twice.
  [[nodiscard]] bool complete() const { return watch_.complete() && watch_.topics_before().has_value(); }
  /// Of now. Loads are since the call before.
  [[nodiscard]] TopView view();

 private:
  struct Gpus {
    std::vector<GpuUsage> devices;
    std::map<std::uint32_t, double> process_mib;
  };
  void sample_gpus();
  void add_loads(TopService& service, std::map<std::uint32_t, double>& processor_s);

  BusWatch watch_;
  bus::Address address_;
  std::map<std::uint32_t, double> processor_s_;  ///< by process, at the view before
  std::int64_t viewed_ns_ = 0;
  Gpus gpus_;
  bool has_gpus_ = true;
  std::future<Gpus> pending_gpus_;
};

void sort_services(TopView& view, TopOrder order);

/// The tables as lines without their ends; the first word of each table's head is in capitals.
[[nodiscard]] std::vector<std::string> top_lines(const TopView& view);
[[nodiscard]] nlohmann::json to_json(const TopView& view);

}  // namespace splatbus::cli
