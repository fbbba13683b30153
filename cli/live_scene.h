#pragma once

#include <chrono>
#include <memory>
#include <optional>

#include "bus/subscriber.h"
#include "gaussians/light.h"
#include "wire/published_model.h"

namespace splatbus::cli {

/// The trainer's live model and the scene's state, as the latched topics tell of them. Not thread-safe.
class LiveScene {
 public:
  explicit LiveScene(std::shared_ptr<bus::Context> context);

  /// Takes in what has arrived.
  void poll(std::chrono::milliseconds timeout);

  /// Null until a model is published, and while its structure has moved on and the newer message has not come.
  [[nodiscard]] const PublishedModel* model() const;
  [[nodiscard]] const SceneState& scene() const { return scene_; }
  [[nodiscard]] bool has_light() const { return has_light_; }
  [[nodiscard]] bool has_objects() const { return has_objects_; }

  /// A whole copy of the averaged model; waits up to `timeout` for one whose structure held still meanwhile.
  [[nodiscard]] std::optional<GaussiansBuffer> copy_average(std::chrono::milliseconds timeout);

 private:
  void take(const bus::Message& message);

  bus::Subscriber subscriber_;
  std::optional<bus::Message> published_;
  std::optional<PublishedModel> model_;
  SceneState scene_;
  bool has_light_ = false, has_objects_ = false;
};

}  // namespace splatbus::cli
