#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "stream_figures.h"

namespace splatbus::cli {

/// A run under its name in the tables.
struct NamedStream {
  std::string name;
  StreamResults results;
};

/// Pictures: `run,time_s,ssim_server,ssim_viewer`.
[[nodiscard]] std::string stream_csv(std::span<const NamedStream> runs);
/// Packets: `run,second,type,megabits`, seconds of the run, only types that came.
[[nodiscard]] std::string bitrate_csv(std::span<const NamedStream> runs);
/// The streamer: `run,time_s,viewers,tick_ms,cpu_share,resident_mb`.
[[nodiscard]] std::string server_csv(std::span<const NamedStream> runs);

/// Bits by type and SSIM over time of each run, one below the other; of several with a rate the curve first.
void write_stream_plots(std::span<const NamedStream> runs, const std::filesystem::path& path);

}  // namespace splatbus::cli
