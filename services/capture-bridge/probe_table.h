#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "gaussians/camera.h"

namespace splatbus::capture_bridge {

struct Probe {
  std::uint64_t probe_id = 0;  ///< the asker's
  std::string asker;           ///< header.source
  Camera camera;               ///< id is ours, role Probe
  /// Of the engine: the first time it was asked and the last. An answer to any of them is one.
  std::uint64_t first_request_id = 0, request_id = 0;
  std::int64_t asked_ns = 0;
  std::int64_t requested_ns = 0;  ///< when the engine was asked last
};

/// Probes that wait for the engine. Bounded: a new one pushes the oldest out.
class ProbeTable {
 public:
  explicit ProbeTable(std::size_t capacity) : capacity_(capacity) {}

  /// Null when the asker's probe of that id is waiting already. `evicted` receives one that had to go.
  Probe* add(std::uint64_t probe_id, const std::string& asker, const Camera& camera, std::int64_t now_ns,
             std::optional<Probe>& evicted);

  /// The probe that a frame answers; each is answered once.
  std::optional<Probe> answer(std::uint32_t camera_id, std::uint64_t request_id);

  /// The engine was asked for it, for the first time or again, under this id. Ids grow.
  static void ask(Probe& probe, std::uint64_t request_id, std::int64_t now_ns);

  /// Takes out those that were asked before `asked_before_ns`.
  std::vector<Probe> expire(std::int64_t asked_before_ns);

  /// Those the engine was last asked for before `requested_before_ns`.
  std::vector<Probe*> overdue(std::int64_t requested_before_ns);

  [[nodiscard]] std::size_t size() const { return waiting_.size(); }

 private:
  std::size_t capacity_;
  std::uint32_t next_camera_id_ = 0;
  std::deque<Probe> waiting_;  // oldest first
};

}  // namespace splatbus::capture_bridge
