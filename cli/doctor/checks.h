#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "bus/address.h"

namespace splatbus::cli {

/// One thing that the doctor looked at.
struct Check {
  enum class Verdict : std::uint8_t { Ok, Warn, Fail };
  std::string name;
  Verdict verdict = Verdict::Ok;
  std::string found;
  std::string advice;  ///< what to do; empty where nothing is to be done
};
using Verdict = Check::Verdict;
[[nodiscard]] const char* to_text(Verdict verdict);

// Each looks and changes nothing: no folder is made, no mode is mended, no port stays taken.

/// Versions of this program, its protocol and what it stands on, and whether the services' programs lie beside it.
[[nodiscard]] Check check_programs(const std::filesystem::path& folder);
/// The page that the gateway serves, in share/splatbus/web beside the programs' folder.
[[nodiscard]] Check check_page(const std::filesystem::path& program_folder);

/// The NVIDIA GPU and its driver; without one everything runs on the CPU.
[[nodiscard]] Check check_gpu();
/// An OpenGL context without a window, as the engine and the viewer make it.
[[nodiscard]] Check check_egl();

/// Memory that can be shared: slabs are sealed memfds, bounded by memory and not by /dev/shm.
[[nodiscard]] Check check_shared_memory();
[[nodiscard]] Check check_descriptors();    ///< ulimit -n
[[nodiscard]] Check check_locked_memory();  ///< ulimit -l
[[nodiscard]] Check check_clock();
/// Free space where `folder` is, or would be.
[[nodiscard]] Check check_disk(const std::string& what, const std::filesystem::path& folder);

/// The folder of a bus on this machine: whose it is, and who may enter.
[[nodiscard]] Check check_bus_folder(const bus::Address& bus);
/// The broker, and whether every process there speaks our protocol.
[[nodiscard]] Check check_bus(const bus::Address& bus);
/// Key files and allow-list: whose they are, who may read them, whether they make sense.
[[nodiscard]] std::vector<Check> check_keys(const std::filesystem::path& folder);

/// Whether somebody listens there already; `who` is what needs it. A port of a running bus's own gateway is fine.
[[nodiscard]] Check check_port(const std::string& host, std::uint16_t port, const std::string& who);
/// Process that listens on a TCP port of this machine; 0 where that cannot be said.
[[nodiscard]] pid_t listener_of(std::uint16_t port);

}  // namespace splatbus::cli
