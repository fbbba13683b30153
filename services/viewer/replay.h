#pragma once

#include <stop_token>
#include <string>

#include "device/device.h"
#include "viewer/viewer.h"

namespace splatbus::viewer {

/// Plays a packet log (stream/packet_log.h) through a follower, as if it came from a streamer: into a window, at the
/// engine's own rate, which then stays; or into PNG files, frame_<number>.png, of which each message that changes the
/// picture makes one, and every n-th is written (`frames`, `out`), the camera `fps` of its pictures a second along its
/// path. Returns how many were drawn. Throws std::runtime_error that names the log, and bus::Error where there is
/// neither window nor folder.
std::uint64_t replay(const std::string& log, const Options& options, Device device, const std::stop_token& stop);

}  // namespace splatbus::viewer
