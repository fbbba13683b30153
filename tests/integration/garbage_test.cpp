#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>
#include <zmq.h>

#include <cstring>
#include <limits>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "pipeline.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {
namespace {

using Bytes = std::vector<std::uint8_t>;
constexpr double kSsim = 0.8;

/// A publisher that sends whatever bytes it is given, as a hostile or broken process would.
class RawPublisher {
 public:
  explicit RawPublisher(const bus::Address& address)
      : context_(zmq_ctx_new()), socket_(zmq_socket(context_, ZMQ_XPUB)) {
    const int linger_ms = 5000;
    zmq_setsockopt(socket_, ZMQ_LINGER, &linger_ms, sizeof linger_ms);
    const int patience_ms = 10000;
    zmq_setsockopt(socket_, ZMQ_RCVTIMEO, &patience_ms, sizeof patience_ms);
    EXPECT_EQ(zmq_connect(socket_, address.publish_endpoint().c_str()), 0);
    // The broker's subscription: from now on it hears us.
    char subscription[256];
    EXPECT_GT(zmq_recv(socket_, subscription, sizeof subscription, 0), 0);
  }
  ~RawPublisher() {
    zmq_close(socket_);
    zmq_ctx_term(context_);
  }
  RawPublisher(const RawPublisher&) = delete;
  RawPublisher& operator=(const RawPublisher&) = delete;

  void send(const std::vector<Bytes>& frames) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      zmq_send(socket_, frames[i].data(), frames[i].size(), i + 1 < frames.size() ? ZMQ_SNDMORE : 0);
    }
    ++sent_;
  }
  void send(const std::string& topic, const Bytes& body) { send({Bytes(topic.begin(), topic.end()), body}); }

  [[nodiscard]] int sent() const { return sent_; }

 private:
  void* context_;
  void* socket_;
  int sent_ = 0;
};

Bytes random_bytes(std::mt19937& random, std::size_t size) {
  Bytes bytes(size);
  for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
  return bytes;
}

/// One real message of every topic that the running pipeline uses.
std::map<std::string, Bytes> collect_messages(Pipeline& pipeline) {
  bus::Subscriber subscriber(pipeline.context(), {"*"});
  std::map<std::string, Bytes> messages;
  EXPECT_TRUE(pipeline.wait_until([&] {
    while (const auto message = subscriber.receive(std::chrono::milliseconds(0))) {
      messages.emplace(message->topic(), Bytes(message->bytes(), message->bytes() + message->size()));
    }
    for (const char* topic : {"engine/cameras", "engine/frame", "capture/reference", "scene/state", "scene/light_depth",
                              "model/published", "trainer/stats", "grid/state", "relight/visibility", "stream/stats",
                              "sys/heartbeat", "sys/liveness", "viewer/pose"}) {
      if (!messages.contains(topic)) return false;
    }
    return true;
  }));
  return messages;
}

/// A real message as if from another source, its tensors pointing where there is nothing.
Bytes with_lying_tensors(Bytes bytes, const std::function<void(wire::Span&)>& lie) {
  auto* header = flatbuffers::GetMutableRoot<wire::Envelope>(bytes.data())->mutable_header();
  const auto* source = header->source();
  bytes[static_cast<std::size_t>(source->Data() - bytes.data()) + source->size() - 1] = '~';
  if (header->mutable_tensors() != nullptr) {
    for (flatbuffers::uoffset_t i = 0; i < header->mutable_tensors()->size(); ++i) {
      lie(*header->mutable_tensors()->GetMutableObject(i)->mutable_span());
    }
  }
  return bytes;
}

class Garbage : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_TRUE(pipeline_.wait_for_picture(kSsim)) << pipeline_.log();
    before_ = pipeline_.pids();
  }

  /// Nobody died of it, and pictures still go all the way.
  void expect_unharmed() {
    ASSERT_TRUE(pipeline_.wait_for_picture(kSsim)) << pipeline_.log();
    EXPECT_EQ(pipeline_.pids(), before_) << pipeline_.log();
    for (const auto& [name, pid] : before_) EXPECT_EQ(pipeline_.status(name).restarts, 0) << name;
  }

  /// A service said that it refused the stranger's message on `topic`, since it is no `schema`.
  [[nodiscard]] bool log_names(const std::string& topic, const std::string& schema) const {
    std::istringstream log(pipeline_.log());
    for (std::string line; std::getline(log, line);) {
      if (line.find(topic + " from stranger") != std::string::npos &&
          line.find("not '" + schema + "'") != std::string::npos) {
        return true;
      }
    }
    return false;
  }

  Pipeline pipeline_;
  std::map<std::string, pid_t> before_;
  std::mt19937 random_{1};
};

TEST_F(Garbage, OnEveryTopicDisturbsNobody) {
  auto messages = collect_messages(pipeline_);
  for (const char* topic : {"capture/input", "capture/probe", "model/insert", "viewer/probe", "viewer/quality",
                            "sys/log", "control/trainer", "control/viewer", "", "*"}) {
    messages.emplace(topic, Bytes());
  }
  {
    RawPublisher raw(pipeline_.address());
    for (const auto& [topic, real] : messages) {
      for (const std::size_t size : {0, 1, 7, 64, 1000, 100000}) raw.send(topic, random_bytes(random_, size));
      for (std::size_t quarter = 1; quarter < 4; ++quarter) {
        raw.send(topic, Bytes(real.begin(), real.begin() + static_cast<std::ptrdiff_t>(real.size() * quarter / 4)));
      }
      raw.send({Bytes(topic.begin(), topic.end())});
      raw.send({Bytes(topic.begin(), topic.end()), real, random_bytes(random_, 10), random_bytes(random_, 10)});
    }
    // What does not verify goes no further than the broker, which counts it.
    ASSERT_TRUE(pipeline_.wait_until([&] {
      const auto counters = pipeline_.status("bus").counters;
      const auto malformed = counters.find("malformed");
      return malformed != counters.end() && malformed->second >= 9 * static_cast<double>(messages.size());
    })) << pipeline_.log();
    for (const auto& [topic, real] : messages) {
      if (real.empty()) continue;
      for (const auto& lie : std::vector<std::function<void(wire::Span&)>>{
               [](wire::Span& span) { span.mutate_slab(0xDEADBEEF); },
               [](wire::Span& span) { span.mutate_offset(std::numeric_limits<std::uint64_t>::max() - 8); },
               [](wire::Span& span) { span.mutate_bytes(std::uint64_t{1} << 62); },
               [](wire::Span& span) { span.mutate_generation(span.generation() + 1); },
               [](wire::Span& span) { span.mutate_storage(wire::Storage::Inline); },
               [](wire::Span& span) { span.mutate_storage(static_cast<wire::Storage>(77)); },
           }) {
        raw.send(topic, with_lying_tensors(real, lie));
      }
    }
  }
  expect_unharmed();
}

TEST_F(Garbage, WrongSchemasAndValuesDisturbNobody) {
  const auto stranger = bus::Context::create(pipeline_.address(), "stranger");
  const bus::Publisher publisher(stranger);
  for (const auto& [topic, schema] :
       std::vector<std::pair<std::string, std::string>>{{"engine/cameras", "EngineCameras/1"},
                                                        {"engine/frame", "EngineFrame/3"},
                                                        {"capture/input", "CaptureInput/3"},
                                                        {"capture/reference", "CaptureReference/3"},
                                                        {"capture/probe", "CaptureProbe/3"},
                                                        {"scene/state", "SceneUpdate/1"},
                                                        {"scene/light_depth", "SceneLightDepth/3"},
                                                        {"model/insert", "ModelInsert/2"},
                                                        {"model/published", "ModelPublished/3"},
                                                        {"grid/state", "GridState/1"},
                                                        {"relight/visibility", "RelightVisibility/1"},
                                                        {"viewer/pose", "ViewerPose/1"},
                                                        {"viewer/probe", "ViewerProbe/1"},
                                                        {"sys/heartbeat", "Heartbeat/1"},
                                                        {"control/trainer", "Control/1"},
                                                        {"control/capture-bridge", "Control/1"}}) {
    const auto log = [](auto& builder, auto header) {
      return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, "not what this topic is for");
    };
    const std::string other = schema + "2";
    publisher.publish(Topic<wire::Log>{topic}, log);                 // another schema, honestly
    publisher.publish(Topic<wire::Log>{topic, false, schema}, log);  // the right name over another table
    publisher.publish(Topic<wire::Log>{topic, false, other}, log);
  }

  // Well-formed messages with values that make no sense.
  constexpr std::uint32_t kCount = 32;
  const std::vector<float> nan(std::size_t{kCount} * 4, std::numeric_limits<float>::quiet_NaN());
  const std::vector<std::uint64_t> zeros(kCount);
  const auto tensor = [&](const char* name, std::vector<std::uint32_t> shape, bus::ElementType type) {
    return bus::OutgoingTensor{
        .name = name,
        .shape = std::move(shape),
        .type = type,
        .inline_data = type == bus::ElementType::F32 ? static_cast<const void*>(nan.data()) : zeros.data()};
  };
  using bus::ElementType;
  publisher.publish(
      topics::kModelInsert,
      {.tensors = {tensor("mean", {3, kCount}, ElementType::F32), tensor("log_scale", {3, kCount}, ElementType::F32),
                   tensor("rotation", {4, kCount}, ElementType::F32),
                   tensor("opacity_logit", {1, kCount}, ElementType::F32),
                   tensor("albedo", {3, kCount}, ElementType::F32), tensor("normal", {3, kCount}, ElementType::F32),
                   tensor("visibility", {1, kCount}, ElementType::F32),
                   tensor("object_id", {kCount}, ElementType::U32)}},
      [](auto& builder, auto header) {
        const auto light = to_wire(builder, Light{});
        return wire::CreateModelInsert(builder, header, 1, 0, light);
      });
  publisher.publish(
      topics::kCaptureInput,
      {.tensors = {tensor("position", {kCount, 3}, ElementType::F32), tensor("normal", {kCount, 3}, ElementType::F32),
                   tensor("albedo", {kCount, 3}, ElementType::F32), tensor("color", {kCount, 3}, ElementType::F32),
                   tensor("footprint", {kCount}, ElementType::F32), tensor("spacing", {kCount}, ElementType::F32),
                   tensor("cosine", {kCount}, ElementType::F32), tensor("object_id", {kCount}, ElementType::U32),
                   tensor("camera", {kCount}, ElementType::U32), tensor("depth", {1, 4, 8}, ElementType::F32)}},
      [](auto& builder, auto header) {
        return wire::CreateCaptureInput(builder, header, 1, 0, to_wire(builder, SceneState{}, 1));
      });
  publisher.publish(topics::kViewerPose, [](auto& builder, auto header) {
    wire::Camera camera = to_wire(Camera{.width = 8, .height = 8, .fx = 1, .fy = 1});
    camera.mutate_fx(std::numeric_limits<float>::quiet_NaN());
    camera.mutate_width(0xFFFFFFFF);
    return wire::CreateViewerPoseDirect(builder, header, "stranger", &camera);
  });

  expect_unharmed();
  for (const auto& [topic, schema] :
       std::vector<std::pair<std::string, std::string>>{{"capture/input", "CaptureInput/3"},
                                                        {"model/insert", "ModelInsert/2"},
                                                        {"model/published", "ModelPublished/3"},
                                                        {"viewer/pose", "ViewerPose/1"}}) {
    EXPECT_TRUE(pipeline_.wait_until([&, &name = topic, &type = schema] { return log_names(name, type); }))
        << topic << ", " << schema << "\n"
        << pipeline_.log();
  }
}

/// Connects to a Unix socket and writes bytes to it.
void write_to_socket(const std::string& path, const Bytes& bytes) {
  const int fd = socket(AF_UNIX, SOCK_SEQPACKET, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
  if (connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    static_cast<void>(send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL));
  }
  close(fd);
}

TEST_F(Garbage, OnTheOtherSocketsDisturbsNobody) {
  for (const std::size_t size : {1, 16, 64, 200, 4096}) {
    write_to_socket(pipeline_.address().slab_socket(), random_bytes(random_, size));
  }
  void* context = zmq_ctx_new();
  void* viewer = zmq_socket(context, ZMQ_DEALER);
  const int linger_ms = 5000;
  zmq_setsockopt(viewer, ZMQ_LINGER, &linger_ms, sizeof linger_ms);
  ASSERT_EQ(zmq_connect(viewer, ("ipc://" + *pipeline_.address().directory + "/streamer").c_str()), 0);
  for (const std::size_t size : {0, 1, 8, 100, 5000, 1000000}) {
    const Bytes bytes = random_bytes(random_, size);
    zmq_send(viewer, bytes.data(), bytes.size(), 0);
    zmq_send(viewer, bytes.data(), bytes.size(), ZMQ_SNDMORE);
    zmq_send(viewer, bytes.data(), bytes.size(), 0);
  }
  zmq_close(viewer);
  zmq_ctx_term(context);
  expect_unharmed();
}

}  // namespace
}  // namespace splatbus::cli
