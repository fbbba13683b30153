#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/statvfs.h>
#include <sys/timex.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>

#include "bus/file_descriptor.h"
#include "checks.h"
#include "units_text.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMebibyte = std::uint64_t{1} << 20;
constexpr std::uint64_t kSlabProbeBytes = 64 * kMebibyte;
constexpr std::uint64_t kScarceMemory = 2048 * kMebibyte;
constexpr std::uint64_t kScarceDisk = 2048 * kMebibyte, kNoDisk = 200 * kMebibyte;
constexpr rlim_t kScarceDescriptors = 4096, kFewDescriptors = 512;

std::string limit_text(rlim_t limit) {
  return limit == RLIM_INFINITY ? "unlimited" : std::to_string(limit);
}

/// A line "MemAvailable:  123 kB" of /proc/meminfo, in bytes.
std::uint64_t available_memory() {
  std::ifstream file("/proc/meminfo");
  std::string key;
  std::uint64_t kibibytes = 0;
  for (std::string line; file >> key; std::getline(file, line)) {
    if (key == "MemAvailable:" && file >> kibibytes) return kibibytes * 1024;
  }
  return 0;
}

/// What the control group leaves, where it has a limit.
std::uint64_t group_memory(std::uint64_t available) {
  std::ifstream limit_file("/sys/fs/cgroup/memory.max"), used_file("/sys/fs/cgroup/memory.current");
  std::uint64_t limit = 0, used = 0;
  if (!(limit_file >> limit) || !(used_file >> used)) return available;
  return std::min(available, limit > used ? limit - used : 0);
}

std::string first_line(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

}  // namespace

const char* to_text(Check::Verdict verdict) {
  return verdict == Verdict::Ok ? "ok" : verdict == Verdict::Warn ? "warn" : "fail";
}

Check check_shared_memory() {
  Check check{.name = "shared memory"};
  const bus::FileDescriptor slab(::memfd_create("splatbus-doctor", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!slab.valid() || ::fallocate(slab.get(), 0, 0, static_cast<off_t>(kSlabProbeBytes)) != 0) {
    return {check.name, Verdict::Fail, fmt::format("a slab of 64 MiB cannot be made: {}", std::strerror(errno)),
            "free memory, or raise the memory limit of the container or service"};
  }
  const std::uint64_t left = group_memory(available_memory());
  struct statvfs shm {};
  const bool has_shm = ::statvfs("/dev/shm", &shm) == 0;
  check.found = fmt::format("{} of memory for slabs; /dev/shm {}", bytes_text(static_cast<double>(left)),
                            has_shm ? bytes_text(static_cast<double>(shm.f_blocks) * static_cast<double>(shm.f_frsize))
                                    : "is not there") +
                " (slabs do not use it)";
  if (left < kScarceMemory) {
    check.verdict = Verdict::Warn;
    check.advice = "close other programs, or lower the trainer's host_mb and the capture-bridge's sample_budget";
  }
  return check;
}

Check check_descriptors() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  Check check{.name = "ulimit -n",
              .found = fmt::format("{}, and up to {}", limit_text(limit.rlim_cur), limit_text(limit.rlim_max))};
  if (limit.rlim_max >= kScarceDescriptors) return check;
  check.verdict = limit.rlim_max < kFewDescriptors ? Verdict::Fail : Verdict::Warn;
  check.advice = "raise the hard limit to 4096 or more (LimitNOFILE= of systemd, --ulimit nofile= of docker)";
  return check;
}

Check check_locked_memory() {
  rlimit limit{};
  ::getrlimit(RLIMIT_MEMLOCK, &limit);
  return {"ulimit -l",
          Verdict::Ok,
          limit.rlim_cur == RLIM_INFINITY
              ? std::string("unlimited")
              : fmt::format("{} (no service locks memory)", bytes_text(static_cast<double>(limit.rlim_cur))),
          {}};
}

Check check_clock() {
  Check check{.name = "clock"};
  const auto now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  std::tm date{};
  ::gmtime_r(&now, &date);
  timex state{};
  const int status = ::adjtimex(&state);
  const bool synchronized = status >= 0 && status != TIME_ERROR && (state.status & STA_UNSYNC) == 0;
  const std::string source = first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource");
  check.found =
      fmt::format("{:04}-{:02}-{:02} UTC, {}{}", date.tm_year + 1900, date.tm_mon + 1, date.tm_mday,
                  synchronized ? "synchronized" : "not known to be synchronized", source.empty() ? "" : ", " + source);
  constexpr int kYearOfThisProgram = 2025;
  if (date.tm_year + 1900 < kYearOfThisProgram) {
    check.verdict = Verdict::Fail;
    check.advice = "set the date: certificates are not valid yet";
  } else if (source == "acpi_pm" || source == "hpet" || source == "jiffies") {
    check.verdict = Verdict::Warn;
    check.advice = "this clock source is slow to read; boot with clocksource=tsc if the machine allows";
  } else if (!synchronized) {
    check.advice = "run an NTP client where several machines work together";
  }
  return check;
}

Check check_disk(const std::string& what, const fs::path& folder) {
  fs::path place = fs::absolute(folder);
  std::error_code ignored;
  while (!fs::exists(place, ignored) && place.has_parent_path() && place != place.root_path())
    place = place.parent_path();
  Check check{.name = "disk, " + what};
  struct statvfs state {};
  if (::statvfs(place.c_str(), &state) != 0) {
    return {check.name, Verdict::Fail, fmt::format("{}: {}", place.string(), std::strerror(errno)),
            "make this folder readable"};
  }
  const auto free = static_cast<std::uint64_t>(state.f_bavail) * state.f_frsize;
  check.found = fmt::format("{} free in {}", bytes_text(static_cast<double>(free)), place.string());
  if (::access(place.c_str(), W_OK) != 0) {
    check.verdict = Verdict::Fail;
    check.found += ", which cannot be written";
    check.advice = fmt::format("make it yours: chown $USER {}", place.string());
  } else if (free < kScarceDisk) {
    check.verdict = free < kNoDisk ? Verdict::Fail : Verdict::Warn;
    check.advice = "free space there: logs, recordings and worlds go to it";
  }
  return check;
}

}  // namespace splatbus::cli
