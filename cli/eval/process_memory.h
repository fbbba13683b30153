#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>

namespace splatbus::cli {

/// Bytes of a process in memory, of pages that it shares with others its part (Pss of /proc/PID/smaps_rollup): the sum
/// over processes counts every page once. nullopt where the process is gone or is not ours to look at.
[[nodiscard]] std::optional<std::uint64_t> resident_bytes(pid_t pid);

/// Bytes in memory that are a process' own (RssAnon of /proc/PID/status): slabs and libraries are in none. It costs the
/// process nothing, while the above holds up its page faults for as long as all its pages are counted. nullopt where
/// the process is gone.
[[nodiscard]] std::optional<std::uint64_t> own_bytes(pid_t pid);

/// Seconds of processor time that a process has had; nullopt where it is gone.
[[nodiscard]] std::optional<double> processor_seconds(pid_t pid);

}  // namespace splatbus::cli
