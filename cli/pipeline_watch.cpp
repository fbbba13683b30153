#include "pipeline_watch.h"

#include <algorithm>
#include <utility>

#include "figures.h"
#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

PipelineWatch::PipelineWatch(std::shared_ptr<bus::Context> context)
    : subscriber_(std::move(context),
                  {"trainer/stats", "grid/state", "stream/stats", "relight/visibility", "viewer/quality"}) {}

void PipelineWatch::poll(std::chrono::milliseconds timeout) {
  for (auto message = subscriber_.receive(timeout); message;
       message = subscriber_.receive(std::chrono::milliseconds(0))) {
    bus::guarded(*message, [&] { take(*message); });
  }
}

void PipelineWatch::take(const bus::Message& message) {
  if (message.topic() == "trainer/stats") {
    const auto& stats = message.root<wire::TrainerStats>("TrainerStats/1");
    state_.trainer = {.epoch = message.header().epoch(),
                      .step = stats.step(),
                      .views = stats.views(),
                      .gaussians = stats.gaussians(),
                      .optimizer_s = stats.optimizer_s(),
                      .steps_per_s = stats.steps_per_s(),
                      .loss = stats.loss(),
                      .ready_references = stats.ready_references(),
                      .ready_inputs = stats.ready_inputs(),
                      .paused = stats.paused(),
                      .host_copied_bytes = stats.host_copied_bytes()};
  } else if (message.topic() == "grid/state") {
    const auto& grid = message.root<wire::GridState>("GridState/1");
    state_.grid = {.rounds = grid.rounds(),
                   .batches_pending = grid.batches_pending(),
                   .gaussians_inserted = grid.gaussians_inserted()};
  } else if (message.topic() == "stream/stats") {
    const auto& stats = message.root<wire::StreamStats>("StreamStats/1");
    state_.stream = {.viewers = stats.viewers(),
                     .wire_mbps = stats.wire_mbps(),
                     .wire_mbps_mean = stats.wire_mbps_mean(),
                     .wire_mbps_peak = stats.wire_mbps_peak()};
  } else if (message.topic() == "relight/visibility") {
    state_.visibility_generation = message.root<wire::RelightVisibility>("RelightVisibility/1").model_generation();
  } else if (message.topic() == "viewer/quality") {
    const auto& quality = message.root<wire::ViewerQuality>("ViewerQuality/1");
    state_.viewer_quality[quality.probe_id()] = {
        .psnr_db = quality.psnr_db(), .ssim = quality.ssim(), .flip = quality.flip()};
    if (state_.first_picture_ns == 0) state_.first_picture_ns = quality.first_picture_ns();
  }
}

StartWatch::StartWatch(std::shared_ptr<bus::Context> context, std::uint64_t gaussians)
    : subscriber_(std::move(context), {"engine/frame", "model/published"}), gaussians_(gaussians) {}

void StartWatch::poll(std::chrono::milliseconds timeout) {
  for (auto message = subscriber_.receive(timeout); message;
       message = subscriber_.receive(std::chrono::milliseconds(0))) {
    bus::guarded(*message, [&] { take(*message); });
  }
}

void StartWatch::take(const bus::Message& message) {
  if (message.topic() == "engine/frame") {
    const std::int64_t captured_ns = message.header().capture_ns();
    first_frame_ns_ = std::min(first_frame_ns_.value_or(captured_ns), captured_ns);
    return;
  }
  const auto& published = message.root<wire::ModelPublished>("ModelPublished/1");
  if (published.count() < gaussians_) return;
  const std::int64_t now_ns = message.header().publish_ns();
  if (!inserted_ns_) {
    inserted_ns_ = now_ns;
    inserted_at_step_ = published.step();
  }
  if (!ready_ns_ && published.step() >= 1) ready_ns_ = now_ns;
  if (!optimised_ns_ && published.step() > inserted_at_step_) optimised_ns_ = now_ns;
}

nlohmann::json StartWatch::summary() const {
  const auto since_first_frame = [&](const std::optional<std::int64_t>& at_ns) {
    if (!at_ns || !first_frame_ns_) return nlohmann::json();
    return nlohmann::json(rounded(static_cast<double>(*at_ns - *first_frame_ns_) / 1e9));
  };
  return {{"enough_gaussians", gaussians_},
          {"inserted_s", since_first_frame(inserted_ns_)},
          {"ready_s", since_first_frame(ready_ns_)},
          {"optimised_s", since_first_frame(optimised_ns_)}};
}

}  // namespace splatbus::cli
