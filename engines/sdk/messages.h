#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "bus/log_sink.h"
#include "bus/subscriber.h"
#include "sdk/splatbus_engine.h"
#include "wire/engine_generated.h"

namespace splatbus::engine_sdk {

/// Which sets of requests are an engine's: those whose latch key is its name, and those without a key, which are for
/// every engine. Where whoever asks has once named it, what he says to all is for others; one that starts anew begins
/// anew.
class SetAddresses {
 public:
  [[nodiscard]] bool is_ours(const wire::Header& header, std::string_view engine);

 private:
  std::string asker_;  ///< who has named it last, and when he started
  std::uint64_t asker_epoch_ = 0;
};

/// The requests of an EngineCameras message that make sense, up to as many as there may be. The others are logged: how
/// many, and what is wrong with the first, as often as `limiter` allows. Any peer may send sets as fast as he likes.
[[nodiscard]] std::vector<splatbus_camera_request> read_requests(const wire::EngineCameras& root,
                                                                 const bus::Message& message, bus::LogLimiter& limiter);

/// The root of an EngineFrame message. The light's generation is a hash of the light: it changes when the light does,
/// and is the same again after a restart under the same light.
[[nodiscard]] flatbuffers::Offset<wire::EngineFrame> build_frame(flatbuffers::FlatBufferBuilder& builder,
                                                                 flatbuffers::Offset<wire::Header> header,
                                                                 const splatbus_frame& frame);

}  // namespace splatbus::engine_sdk
