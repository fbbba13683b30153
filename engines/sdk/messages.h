#pragma once

#include <vector>

#include "bus/subscriber.h"
#include "sdk/splatbus_engine.h"
#include "wire/engine_generated.h"

namespace splatbus::engine_sdk {

/// The requests of an EngineCameras message that make sense; the others are logged.
[[nodiscard]] std::vector<splatbus_camera_request> read_requests(const wire::EngineCameras& root,
                                                                 const bus::Message& message);

/// The root of an EngineFrame message. The light's generation is a hash of the light: it changes when the light does,
/// and is the same again after a restart under the same light.
[[nodiscard]] flatbuffers::Offset<wire::EngineFrame> build_frame(flatbuffers::FlatBufferBuilder& builder,
                                                                 flatbuffers::Offset<wire::Header> header,
                                                                 const splatbus_frame& frame);

}  // namespace splatbus::engine_sdk
