#pragma once

#include <string>

#include "bus/frames.h"

namespace splatbus::bus_service {

/// Of messages that have been verified.
[[nodiscard]] inline const wire::Header& header_of(const bus::Frames& frames) {
  return *flatbuffers::GetRoot<wire::Envelope>(frames.body.data())->header();
}

[[nodiscard]] inline std::string latch_key_of(const wire::Header& header) {
  return header.latch_key() == nullptr ? std::string() : header.latch_key()->str();
}

}  // namespace splatbus::bus_service
