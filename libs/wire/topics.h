#pragma once

#include <cstdint>
#include <string_view>

namespace splatbus {

namespace wire {
struct CaptureInput;
struct CaptureProbe;
struct CaptureReference;
struct Control;
struct EngineCameras;
struct EngineFrame;
struct GridState;
struct Heartbeat;
struct Liveness;
struct Log;
struct ModelInsert;
struct ModelPublished;
struct RelightVisibility;
struct SceneLightDepth;
struct SceneUpdate;
struct StreamStats;
struct StreamerOffer;
struct Topics;
struct TrainerStats;
struct ViewerPose;
struct ViewerProbe;
struct ViewerQuality;
}  // namespace wire

/// Of all that crosses a process boundary: raised when a peer of before could misread or break what is new.
inline constexpr std::uint32_t kProtocolVersion = 2;

/// What Header.schema says of a root table: its name and version.
template <class Table>
inline constexpr std::string_view kSchema{};
template <>
inline constexpr std::string_view kSchema<wire::CaptureInput> = "CaptureInput/3";
template <>
inline constexpr std::string_view kSchema<wire::CaptureProbe> = "CaptureProbe/3";
template <>
inline constexpr std::string_view kSchema<wire::CaptureReference> = "CaptureReference/3";
template <>
inline constexpr std::string_view kSchema<wire::Control> = "Control/1";
template <>
inline constexpr std::string_view kSchema<wire::EngineCameras> = "EngineCameras/1";
template <>
inline constexpr std::string_view kSchema<wire::EngineFrame> = "EngineFrame/3";
template <>
inline constexpr std::string_view kSchema<wire::GridState> = "GridState/1";
template <>
inline constexpr std::string_view kSchema<wire::Heartbeat> = "Heartbeat/1";
template <>
inline constexpr std::string_view kSchema<wire::Liveness> = "Liveness/1";
template <>
inline constexpr std::string_view kSchema<wire::Log> = "Log/1";
template <>
inline constexpr std::string_view kSchema<wire::ModelInsert> = "ModelInsert/2";
template <>
inline constexpr std::string_view kSchema<wire::ModelPublished> = "ModelPublished/3";
template <>
inline constexpr std::string_view kSchema<wire::RelightVisibility> = "RelightVisibility/2";
template <>
inline constexpr std::string_view kSchema<wire::SceneLightDepth> = "SceneLightDepth/3";
template <>
inline constexpr std::string_view kSchema<wire::SceneUpdate> = "SceneUpdate/1";
template <>
inline constexpr std::string_view kSchema<wire::StreamStats> = "StreamStats/2";
template <>
inline constexpr std::string_view kSchema<wire::StreamerOffer> = "StreamerOffer/1";
template <>
inline constexpr std::string_view kSchema<wire::Topics> = "Topics/1";
template <>
inline constexpr std::string_view kSchema<wire::TrainerStats> = "TrainerStats/2";
template <>
inline constexpr std::string_view kSchema<wire::ViewerPose> = "ViewerPose/1";
template <>
inline constexpr std::string_view kSchema<wire::ViewerProbe> = "ViewerProbe/1";
template <>
inline constexpr std::string_view kSchema<wire::ViewerQuality> = "ViewerQuality/1";

/// A topic of the bus and the root table of its messages. The names are views: constants, or outlived by their owner.
template <class Table>
struct Topic {
  std::string_view name;
  bool latch = false;  ///< the broker keeps the last message of each latch key for later subscribers
  std::string_view schema = kSchema<Table>;
};

/// Every topic, once. Who publishes and who reads which: docs/architecture.md.
namespace topics {
inline constexpr bool kLatched = true;
inline constexpr Topic<wire::EngineCameras> kEngineCameras{"engine/cameras", kLatched};
inline constexpr Topic<wire::EngineFrame> kEngineFrame{"engine/frame"};
inline constexpr Topic<wire::CaptureInput> kCaptureInput{"capture/input"};
inline constexpr Topic<wire::CaptureReference> kCaptureReference{"capture/reference"};
inline constexpr Topic<wire::CaptureProbe> kCaptureProbe{"capture/probe"};
inline constexpr Topic<wire::SceneUpdate> kSceneState{"scene/state", kLatched};
inline constexpr Topic<wire::SceneLightDepth> kSceneLightDepth{"scene/light_depth", kLatched};
inline constexpr Topic<wire::ModelInsert> kModelInsert{"model/insert"};
inline constexpr Topic<wire::ModelPublished> kModelPublished{"model/published", kLatched};
inline constexpr Topic<wire::TrainerStats> kTrainerStats{"trainer/stats"};
/// Of a trainer that stands by: the capture-bridge has the views rendered again that it lacks.
inline constexpr Topic<wire::TrainerStats> kTrainerStandby{"trainer/standby"};
inline constexpr Topic<wire::GridState> kGridState{"grid/state", kLatched};
inline constexpr Topic<wire::RelightVisibility> kRelightVisibility{"relight/visibility", kLatched};
inline constexpr Topic<wire::ViewerPose> kViewerPose{"viewer/pose"};
inline constexpr Topic<wire::ViewerProbe> kViewerProbe{"viewer/probe"};
inline constexpr Topic<wire::ViewerQuality> kViewerQuality{"viewer/quality"};
inline constexpr Topic<wire::StreamStats> kStreamStats{"stream/stats"};
inline constexpr Topic<wire::StreamerOffer> kStreamerOffer{"stream/offer", kLatched};  ///< keyed by source
inline constexpr Topic<wire::Heartbeat> kHeartbeat{"sys/heartbeat", kLatched};         ///< keyed by source
inline constexpr Topic<wire::Liveness> kLiveness{"sys/liveness", kLatched};
inline constexpr Topic<wire::Topics> kTopics{"sys/topics", kLatched};
inline constexpr Topic<wire::Log> kLog{"sys/log"};

/// `name` is "control/" and a service's kind or source; it outlives the topic.
[[nodiscard]] constexpr Topic<wire::Control> control(std::string_view name) {
  return {name};
}
}  // namespace topics

}  // namespace splatbus
