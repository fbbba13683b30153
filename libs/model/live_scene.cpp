#include "model/live_scene.h"

#include <utility>

#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus {

LiveScene::LiveScene(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  subscriber_
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished& published, const bus::Message& message) {
            published_ = {.generation = published.generation(), .step = published.step(), .count = published.count()};
            message_ = message;
            model_.reset();
          })
      .on(topics::kSceneState, [this](const wire::SceneUpdate& body, const bus::Message&) {
        scene_ = from_wire(*body.scene());
        has_scene_ = true;
      });
}

void LiveScene::poll(std::chrono::milliseconds timeout) {
  subscriber_.dispatch_newest(timeout);
}

const PublishedModel* LiveScene::model(Device kind) {
  if (!message_) return nullptr;
  if (model_ && model_kind_ == kind && model_->refresh()) return &*model_;
  // The slab may not have been there a moment ago, or the message is newer than what the writer had committed.
  const std::optional<PublishedModel> before = std::exchange(model_, {});
  bus::guarded(*message_, [&] {
    model_ = PublishedModel::open(*message_, kind, PublishedModel::Need::Average, before ? &*before : nullptr);
  });
  model_kind_ = kind;
  return model_ ? &*model_ : nullptr;
}

std::optional<GaussiansBuffer> LiveScene::copy_average(std::chrono::milliseconds timeout) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  do {
    if (const PublishedModel* live = model()) {
      GaussiansBuffer copy = GaussiansBuffer::copy_of(live->average());
      if (live->still_valid()) return copy;
    }
    poll(std::chrono::milliseconds(20));
  } while (std::chrono::steady_clock::now() < end);
  return {};
}

}  // namespace splatbus
