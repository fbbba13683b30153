#include <flatbuffers/base.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/utsname.h>
#include <unistd.h>
#include <zmq.h>

#include "checks.h"
#include "wire/topics.h"

namespace splatbus::cli {

namespace fs = std::filesystem;

Check check_programs(const fs::path& folder) {
  int major = 0, minor = 0, patch = 0;
  zmq_version(&major, &minor, &patch);
  utsname kernel{};
  ::uname(&kernel);
  Check check{.name = "versions",
              .found = fmt::format("splatbus {}, protocol {}, ZeroMQ {}.{}.{}, FlatBuffers {}.{}.{}, Linux {}",
                                   SPLATBUS_VERSION, kProtocolVersion, major, minor, patch, FLATBUFFERS_VERSION_MAJOR,
                                   FLATBUFFERS_VERSION_MINOR, FLATBUFFERS_VERSION_REVISION, kernel.release)};
  std::vector<std::string> missing;
  for (const char* name :
       {"bus", "engine-sim", "capture-bridge", "expander", "trainer", "relight", "streamer", "viewer", "gateway"}) {
    const fs::path program = folder / (std::string("splatbus-") + name);
    if (::access(program.c_str(), X_OK) != 0) missing.push_back(program.filename().string());
  }
  if (!missing.empty()) {
    check.verdict = Verdict::Fail;
    check.found += fmt::format("; missing in {}: {}", folder.string(), fmt::join(missing, ", "));
    check.advice = "build them with './splatbus build', or install the package again";
  } else if (zmq_has("curve") == 0) {
    check.verdict = Verdict::Warn;
    check.advice = "this ZeroMQ has no CURVE: only this machine can be on the bus; use Debian's libzmq5";
  }
  return check;
}

Check check_page(const fs::path& program_folder) {
  const fs::path page = program_folder.parent_path() / "share/splatbus/web/index.html";
  if (::access(page.c_str(), R_OK) == 0) return {"page", Verdict::Ok, page.parent_path().string(), {}};
  return {"page", Verdict::Warn,
          fmt::format("{} is not there: the gateway has nothing to show in a browser", page.string()),
          "build it with './splatbus build', which needs emscripten, and npm or esbuild, or install the package"};
}

}  // namespace splatbus::cli
