#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#include "bus/error.h"
#include "bus/keys.h"
#include "bus/service.h"
#include "bus_probe.h"
#include "bus_watch.h"
#include "checks.h"
#include "topic_watch.h"
#include "verbs.h"
#include "wire/topics.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
constexpr double kPatienceS = 3;

/// What to do about these, which speak another protocol. A successor is no process that could be restarted: the swap
/// that started it refuses it.
std::string advice_for(const std::vector<std::string>& sources) {
  static const std::string ending = bus::successor_name("");
  std::vector<std::string> services, predecessors;
  for (const std::string& source : sources) {
    if (source.ends_with(ending))
      predecessors.push_back(source.substr(0, source.size() - ending.size()));
    else
      services.push_back(source);
  }
  std::string advice;
  if (!services.empty()) {
    advice =
        fmt::format("start them again with programs of one version: splatbus restart {}", fmt::join(services, " "));
  }
  for (const std::string& name : predecessors) {
    advice += fmt::format("{}swap to a program of our version: splatbus swap {} --program PATH",
                          advice.empty() ? "" : "; ", name);
  }
  return advice;
}

}  // namespace

Check check_bus_folder(const bus::Address& bus) {
  Check check{.name = "bus folder"};
  if (!bus.is_local()) return {check.name, Verdict::Ok, "none: this bus is on tcp", {}};
  const std::string& folder = *bus.directory;
  struct stat status {};
  if (::lstat(folder.c_str(), &status) != 0) {
    if (errno != ENOENT) {
      return {check.name, Verdict::Fail, fmt::format("{}: {}", folder, std::strerror(errno)),
              "choose another folder with --bus or SPLATBUS_BUS"};
    }
    fs::path parent = fs::path(folder).parent_path();
    std::error_code ignored;
    while (!fs::exists(parent, ignored) && parent.has_relative_path()) parent = parent.parent_path();
    check.found = fmt::format("{} is made at the first start", folder);
    if (::access(parent.c_str(), W_OK | X_OK) != 0) {
      check.verdict = Verdict::Fail;
      check.found = fmt::format("{} cannot be made: {} cannot be written", folder, parent.string());
      check.advice = "choose another folder with --bus or SPLATBUS_BUS";
    }
    return check;
  }
  check.found = fmt::format("{}, mode {:04o}", folder, status.st_mode & 07777U);
  const auto fail = [&](const std::string& why, const std::string& advice) {
    check.verdict = Verdict::Fail;
    check.found += ": " + why;
    check.advice = advice;
    return check;
  };
  if (!S_ISDIR(status.st_mode)) return fail("it is not a folder", fmt::format("remove {}", folder));
  if (status.st_uid != ::geteuid()) {
    return fail(fmt::format("it belongs to another user ({})", status.st_uid),
                "choose another folder with --bus or SPLATBUS_BUS");
  }
  if ((status.st_mode & 0700U) != 0700U)
    return fail("its owner may not use it", fmt::format("run: chmod 0700 {}", folder));
  if ((status.st_mode & 077U) == 0) return check;
  std::error_code ignored;
  if (!fs::is_empty(folder, ignored) && !fs::exists(folder + "/lock", ignored)) {
    return fail("others may enter it, and it holds files that are not a bus's",
                fmt::format("choose a folder of its own, or run: chmod 0700 {}", folder));
  }
  check.verdict = Verdict::Warn;
  check.found += ": others may enter it until the next start";
  check.advice = fmt::format("run: chmod 0700 {}", folder);
  return check;
}

Check check_bus(const bus::Address& bus) {
  Check check{.name = "bus"};
  try {
    require_bus(bus);
  } catch (const std::exception&) {
    check.found = fmt::format("nothing runs at {}", bus.text());
    return check;
  }
  try {
    BusWatch watch(connect(bus));
    for (const Deadline deadline(kPatienceS); !watch.complete() && !deadline.passed();) watch.follow(kPatience);
    if (!watch.complete()) {
      return {check.name, Verdict::Fail, fmt::format("{} answers and says nothing", bus.text()),
              "restart the bus: splatbus restart bus"};
    }
    std::vector<std::string> others, names, gone;
    for (const auto& [source, node] : watch.nodes()) {
      if (node.protocol != kProtocolVersion) {
        others.push_back(fmt::format("{} ({})", source, node.protocol));
        names.push_back(source);
      }
      if (!node.alive || node.state == "Failed") gone.push_back(source);
    }
    check.found = fmt::format("{} processes at {}", watch.nodes().size(), bus.text());
    if (!others.empty()) {
      check.verdict = Verdict::Fail;
      check.found += fmt::format("; of another protocol than our {}: {}", kProtocolVersion, fmt::join(others, ", "));
      check.advice = advice_for(names);
    } else if (!gone.empty()) {
      check.verdict = Verdict::Warn;
      check.found += fmt::format("; not alive: {}", fmt::join(gone, ", "));
      check.advice = "see why with: splatbus status, splatbus logs NAME";
    }
  } catch (const std::exception& error) {
    return {check.name, Verdict::Fail, error.what(), "check --key and --server-key"};
  }
  return check;
}

std::vector<Check> check_keys(const fs::path& folder) {
  std::vector<Check> checks;
  const std::string advice = "run: chmod 0600 on it, or make another with 'splatbus keys new'";
  std::error_code error;
  int good = 0;
  for (fs::directory_iterator file(folder, error), end; !error && file != end; file.increment(error)) {
    if (file->path().extension() != ".key") continue;
    try {
      static_cast<void>(bus::read_key_file(file->path()));
      ++good;
    } catch (const bus::Error& reason) {
      checks.push_back({"keys", Verdict::Fail, reason.what(), advice});
    }
  }
  std::size_t allowed = 0;
  try {
    allowed = bus::read_allow_list(folder / "allowed").size();
  } catch (const bus::Error& reason) {
    checks.push_back(
        {"keys", Verdict::Fail, reason.what(), "nobody gets in until this list is mended: see 'splatbus keys list'"});
  }
  if (error && error != std::errc::no_such_file_or_directory) {
    checks.push_back({"keys", Verdict::Fail, fmt::format("{}: {}", folder.string(), error.message()),
                      "make this folder yours, with mode 0700"});
  }
  if (!checks.empty()) return checks;
  if (good == 0) {
    return {
        {"keys", Verdict::Ok, fmt::format("none in {}; only tcp beyond this machine needs them", folder.string()), {}}};
  }
  return {{"keys", Verdict::Ok, fmt::format("{} of our own, {} allowed, in {}", good, allowed, folder.string()), {}}};
}

}  // namespace splatbus::cli
