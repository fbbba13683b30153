#pragma once

#include <future>
#include <optional>
#include <string>

#include "viewer/stream_receiver.h"

namespace splatbus::viewer {

/// Writes what a viewer shows as a file for other programs, beside the pictures.
class ModelSaver {
 public:
  ModelSaver() = default;
  /// Waits for what is being written, and logs the outcome that nobody has taken.
  ~ModelSaver();
  ModelSaver(const ModelSaver&) = delete;
  ModelSaver& operator=(const ModelSaver&) = delete;

  /// `path` ends in .ply, .glb or .spz. False while another is being written.
  bool begin(StreamReceiver& receiver, const std::string& path);
  /// What has become of it, once.
  [[nodiscard]] std::optional<std::string> take_outcome();

 private:
  std::future<std::string> outcome_;
};

}  // namespace splatbus::viewer
