#include "pipeline_watch.h"

#include <algorithm>
#include <utility>

#include "figures.h"
#include "wire/engine_generated.h"
#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

PipelineWatch::PipelineWatch(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  using bus::Message;
  subscriber_
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& stats, const Message& message) {
            state_.trainer = {.epoch = message.header().epoch(),
                              .step = stats.step(),
                              .views = stats.views(),
                              .gaussians = stats.gaussians(),
                              .optimizer_s = stats.optimizer_s(),
                              .steps_per_s = stats.steps_per_s(),
                              .views_per_s = stats.views_per_s(),
                              .loss = stats.loss(),
                              .ready_references = stats.ready_references(),
                              .ready_inputs = stats.ready_inputs(),
                              .paused = stats.paused(),
                              .host_copied_bytes = stats.host_copied_bytes(),
                              .unpaired_views = stats.unpaired_views(),
                              .active = stats.active(),
                              .frozen = stats.frozen(),
                              .spilled = stats.spilled(),
                              .pages_active = stats.pages_active(),
                              .pages_frozen = stats.pages_frozen(),
                              .pages_spilled = stats.pages_spilled(),
                              .device_bytes = stats.device_bytes(),
                              .host_bytes = stats.host_bytes(),
                              .disk_bytes = stats.disk_bytes(),
                              .masked_share = stats.masked_share()};
          })
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished& published, const Message&) {
            state_.page_bytes = std::uint64_t{published.page_words()} * sizeof(std::uint32_t);
          })
      .on(topics::kGridState,
          [this](const wire::GridState& grid, const Message&) {
            state_.grid = {.rounds = grid.rounds(),
                           .batches_pending = grid.batches_pending(),
                           .gaussians_inserted = grid.gaussians_inserted()};
          })
      .on(topics::kStreamStats,
          [this](const wire::StreamStats& stats, const Message& message) {
            state_.stream = {.viewers = stats.viewers(),
                             .wire_mbps = stats.wire_mbps(),
                             .wire_mbps_mean = stats.wire_mbps_mean(),
                             .wire_mbps_peak = stats.wire_mbps_peak(),
                             .total_bytes = {},
                             .published_ns = message.header().publish_ns()};
            if (stats.by_type() == nullptr) return;
            for (const auto* type : *stats.by_type())
              state_.stream.total_bytes[type->body()->str()] = type->total_bytes();
          })
      .on(topics::kRelightVisibility,
          [this](const wire::RelightVisibility& visibility, const Message&) {
            state_.visibility_generation = visibility.model_generation();
          })
      .on(topics::kViewerQuality, [this](const wire::ViewerQuality& quality, const Message&) {
        state_.viewer_quality[quality.probe_id()] = {
            .psnr_db = quality.psnr_db(), .ssim = quality.ssim(), .flip = quality.flip()};
        if (state_.first_picture_ns == 0) state_.first_picture_ns = quality.first_picture_ns();
      });
}

void PipelineWatch::poll(std::chrono::milliseconds timeout) {
  subscriber_.dispatch_all(timeout);
}

StartWatch::StartWatch(std::shared_ptr<bus::Context> context, std::uint64_t gaussians)
    : subscriber_(std::move(context)), gaussians_(gaussians) {
  subscriber_
      .on(topics::kEngineFrame,
          [this](const wire::EngineFrame&, const bus::Message& message) {
            const auto* pictures = message.header().tensors();
            if (pictures == nullptr || pictures->size() == 0) return;  // before anybody has asked for one
            const std::int64_t captured_ns = message.header().capture_ns();
            first_frame_ns_ = std::min(first_frame_ns_.value_or(captured_ns), captured_ns);
          })
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished& published, const bus::Message& message) { take(published, message); });
}

void StartWatch::poll(std::chrono::milliseconds timeout) {
  subscriber_.dispatch_all(timeout);
}

void StartWatch::take(const wire::ModelPublished& published, const bus::Message& message) {
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
          {"optimized_s", since_first_frame(optimised_ns_)}};
}

}  // namespace splatbus::cli
