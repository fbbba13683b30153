#include "viewer_watch.h"

#include <utility>

#include "wire/convert.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

ViewerWatch::ViewerWatch(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  subscriber_
      .on(topics::kViewerPose,
          [this](const wire::ViewerPose& pose, const bus::Message& message) {
            poses_[pose.viewer()->str()] = {.camera = from_wire(*pose.camera()),
                                            .told_ns = message.header().publish_ns()};
          })
      .on(topics::kViewerQuality, [this](const wire::ViewerQuality& quality, const bus::Message& message) {
        answers_[quality.viewer()->str()].insert_or_assign(
            quality.probe_id(),
            Answer{.quality = {.psnr_db = quality.psnr_db(), .ssim = quality.ssim(), .flip = quality.flip()},
                   .gaussians = quality.gaussians(),
                   .told_ns = message.header().publish_ns()});
      });
}

void ViewerWatch::poll(std::chrono::milliseconds timeout) {
  subscriber_.dispatch_all(timeout);
}

const ViewerWatch::Pose* ViewerWatch::pose(const std::string& viewer) const {
  const auto found = poses_.find(viewer);
  return found == poses_.end() ? nullptr : &found->second;
}

const ViewerWatch::Answer* ViewerWatch::answer(const std::string& viewer, std::uint64_t probe_id) const {
  const auto answers = answers_.find(viewer);
  if (answers == answers_.end()) return nullptr;
  const auto found = answers->second.find(probe_id);
  return found == answers->second.end() ? nullptr : &found->second;
}

}  // namespace splatbus::cli
