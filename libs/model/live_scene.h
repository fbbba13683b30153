#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>

#include "bus/subscriber.h"
#include "gaussians/light.h"
#include "model/published_model.h"

namespace splatbus {

/// The trainer's live model and the scene's state, as the latched topics tell of them. Not thread-safe.
class LiveScene {
 public:
  explicit LiveScene(std::shared_ptr<bus::Context> context);

  /// Takes in what has arrived.
  void poll(std::chrono::milliseconds timeout);

  /// What the newest model/published says of the model.
  struct Published {
    std::uint64_t generation = 0, step = 0, count = 0;
  };
  [[nodiscard]] const std::optional<Published>& published() const { return published_; }

  /// The averaged model with its values as they are now, in memory of `kind`: read in place where it lies there, else
  /// copied. Null until one is published, and while its structure has moved on and the newer message has not come.
  /// Valid until the next call.
  [[nodiscard]] const PublishedModel* model(Device kind = Device::Cpu);
  [[nodiscard]] const SceneState& scene() const { return scene_; }
  [[nodiscard]] bool has_scene() const { return has_scene_; }

  /// A whole copy of the averaged model; waits up to `timeout` for one whose structure held still meanwhile.
  [[nodiscard]] std::optional<GaussiansBuffer> copy_average(std::chrono::milliseconds timeout);

 private:
  bus::Subscriber subscriber_;
  std::optional<bus::Message> message_;
  std::optional<Published> published_;
  std::optional<PublishedModel> model_;
  Device model_kind_ = Device::Cpu;
  SceneState scene_;
  bool has_scene_ = false;
};

}  // namespace splatbus
