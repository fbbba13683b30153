#include "sdk/splatbus_engine.h"

#include <fmt/format.h>

#include <cstring>
#include <exception>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/error.h"
#include "bus/heartbeat_thread.h"
#include "bus/log_sink.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/trace.h"
#include "sdk/frame_rings.h"
#include "sdk/frame_sender.h"
#include "sdk/image_memory.h"
#include "sdk/messages.h"
#include "sdk/validate.h"

using namespace splatbus;
using engine_sdk::FrameRings;

namespace {

thread_local std::string
    open_error;  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables): C errors without a handle

/// What the C ABI calls an argument error.
class ArgumentError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace

struct splatbus_engine {
  splatbus_engine(const std::shared_ptr<bus::Context>& bus_context, Device memory)
      : context(bus_context),
        service(context, parameters, stop.get_token(), memory),
        subscriber(context),
        rings(context, memory),
        sender(context),
        heartbeats(service, "engine") {
    subscriber.on(topics::kEngineCameras, [this](const wire::EngineCameras& root, const bus::Message& message) {
      if (addresses.is_ours(message.header(), context->source())) {
        requests_changed |= take_requests(engine_sdk::read_requests(root, message, refusals));
      }
    });
  }

  /// Replaces the set of requests; true when it is another.
  bool take_requests(std::vector<splatbus_camera_request> newest) {
    const bool same =
        newest.size() == requests.size() &&
        (newest.empty() || std::memcmp(newest.data(), requests.data(), newest.size() * sizeof(newest.front())) == 0);
    if (!same) requests = std::move(newest);
    return !same;
  }

  void give_back_unused_rings() {
    for (auto& ring : rings.take_unused(bus::now_ns())) sender.give_back(std::move(ring));
  }

  std::shared_ptr<bus::Context> context;
  bus::Parameters parameters{{}};
  std::stop_source stop;
  bus::ServiceContext service;
  bus::Subscriber subscriber;
  FrameRings rings;
  engine_sdk::FrameSender sender;
  bus::HeartbeatThread heartbeats;

  engine_sdk::SetAddresses addresses;
  bus::LogLimiter refusals;
  std::vector<splatbus_camera_request> requests;
  bool requests_changed = false;  ///< since the last poll
  std::optional<engine_sdk::EngineClock> last;
  std::int64_t capture_ns = 0;  ///< when the first camera of the last frame was submitted
  std::string error;
};

namespace {

/// Runs `call` and turns what it throws into a status and words: no exception crosses the C boundary.
template <class Call>
splatbus_status guarded_call(std::string& error, Call&& call) {
  try {
    call();
    return SPLATBUS_OK;
  } catch (const ArgumentError& wrong) {
    error = wrong.what();
    return SPLATBUS_ERROR_ARGUMENT;
  } catch (const std::exception& failed) {
    error = failed.what();
    return SPLATBUS_ERROR_BUS;
  }
}

void require(bool right, const char* what) {
  if (!right) throw ArgumentError(what);
}

}  // namespace

extern "C" {

splatbus_status splatbus_engine_open(const char* address, const char* source, uint32_t abi, uint32_t memory,
                                     splatbus_engine** out) {
  return guarded_call(open_error, [&] {
    // First of all: a caller of another ABI may have passed no `out` at this place.
    if (abi != SPLATBUS_ENGINE_ABI) {
      throw ArgumentError(fmt::format("splatbus_engine_open: the engine was built for ABI {}, this library has {}", abi,
                                      SPLATBUS_ENGINE_ABI));
    }
    require(out != nullptr, "splatbus_engine_open: out is NULL");
    *out = nullptr;
    require(source != nullptr && *source != '\0', "splatbus_engine_open: source is NULL or empty");
    try {
      const bus::Address where = address == nullptr ? bus::Address::from_environment() : bus::Address::parse(address);
      const Device kind = engine_sdk::memory_kind(memory);
      *out = std::make_unique<splatbus_engine>(bus::Context::create(where, source), kind).release();
    } catch (const bus::Error& wrong) {
      throw ArgumentError(fmt::format("splatbus_engine_open: {}", wrong.what()));
    }
  });
}

void splatbus_engine_close(splatbus_engine* engine) {
  if (engine == nullptr) return;
  const std::unique_ptr<splatbus_engine> owned(engine);
  try {
    owned->heartbeats.finish(wire::ServiceState::Stopping, {});
  } catch (const std::exception& failed) {
    open_error = failed.what();
  }
}

splatbus_status splatbus_engine_poll(splatbus_engine* engine, int timeout_ms, const splatbus_camera_request** requests,
                                     size_t* count, int* changed) {
  if (engine == nullptr) return SPLATBUS_ERROR_ARGUMENT;
  return guarded_call(engine->error, [&] {
    require(requests != nullptr && count != nullptr && changed != nullptr,
            "splatbus_engine_poll: requests, count or changed is NULL");
    require(timeout_ms >= 0, "splatbus_engine_poll: timeout_ms is below 0");
    engine->subscriber.dispatch_newest(std::chrono::milliseconds(timeout_ms));
    *changed = std::exchange(engine->requests_changed, false) ? 1 : 0;
    *requests = engine->requests.data();
    *count = engine->requests.size();
  });
}

splatbus_status splatbus_engine_submit(splatbus_engine* engine, const splatbus_frame* frame) {
  return splatbus_engine_submit_all(engine, frame, 1);
}

splatbus_status splatbus_engine_submit_all(splatbus_engine* engine, const splatbus_frame* frames, size_t count) {
  if (engine == nullptr) return SPLATBUS_ERROR_ARGUMENT;
  return guarded_call(engine->error, [&] {
    require(frames != nullptr || count == 0, "splatbus_engine_submit: frames are NULL");
    std::span left(frames, count);
    engine->give_back_unused_rings();
    bus::TracedWork work("submit picture");
    std::vector<std::int64_t> captured_ns;
    std::optional<engine_sdk::EngineClock> last = engine->last;
    for (const splatbus_frame& frame : left) {
      std::string wrong = engine_sdk::problem(frame);
      if (wrong.empty() && last) wrong = engine_sdk::problem(frame, *last);
      if (!wrong.empty()) throw ArgumentError(fmt::format("splatbus_engine_submit: frame {}: {}", frame.frame, wrong));
      const bool same_frame = last && last->frame == frame.frame;
      const std::int64_t before = captured_ns.empty() ? engine->capture_ns : captured_ns.back();
      captured_ns.push_back(same_frame ? before : bus::now_ns());
      last = {.frame = frame.frame, .time_s = frame.time_s};
    }
    while (!left.empty()) {
      std::vector<engine_sdk::WrittenFrame> written = engine->rings.write(left, bus::now_ns());
      for (const engine_sdk::WrittenFrame& one : written) {
        if (!one.ring) continue;
        if (const std::string refusal = engine->sender.refusal(*one.ring); !refusal.empty()) {
          engine->rings.forget(*one.ring);
          throw bus::Error(refusal);
        }
      }
      for (std::size_t i = 0; i < written.size(); ++i) {
        const splatbus_frame& frame = left[i];
        engine->capture_ns = captured_ns[count - left.size() + i];
        work.is_of(engine->capture_ns, 0);
        engine->sender.send(frame, std::move(written[i]), engine->capture_ns);
        engine->last = {.frame = frame.frame, .time_s = frame.time_s};
      }
      left = left.subspan(written.size());
    }
    engine->service.counter("host_copied_bytes", static_cast<double>(engine->rings.host_copied_bytes()));
    if (const std::uint64_t dropped = engine->sender.dropped(); dropped > 0) {
      engine->service.counter("frames_dropped", static_cast<double>(dropped));
    }
  });
}

splatbus_status splatbus_engine_counter(splatbus_engine* engine, const char* name, double value) {
  if (engine == nullptr) return SPLATBUS_ERROR_ARGUMENT;
  return guarded_call(engine->error, [&] {
    require(name != nullptr && *name != '\0', "splatbus_engine_counter: name is NULL or empty");
    engine->service.counter(name, value);
  });
}

uint64_t splatbus_engine_frames_dropped(const splatbus_engine* engine) {
  return engine == nullptr ? 0 : engine->sender.dropped();
}

const char* splatbus_engine_last_error(const splatbus_engine* engine) {
  return engine == nullptr ? open_error.c_str() : engine->error.c_str();
}

}  // extern "C"
