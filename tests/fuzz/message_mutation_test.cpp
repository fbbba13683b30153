// Thousands of mutated messages, the same ones in every run, through everything that reads a message before a service
// does: the header's verification, the root's, the tensors, and the broker's inlining. Sanitizers tell when one of them
// reads what it must not.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "../unit/bus/bus_fixture.h"
#include "../unit/bus/fake_broker.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/inliner.h"
#include "bus/slab_memory.h"
#include "bus/subscriber.h"
#include "mutate.h"
#include "wire/capture_generated.h"
#include "wire/engine_generated.h"
#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"

namespace splatbus::fuzz {
namespace {

constexpr std::uint64_t slab_id = 77;
constexpr const char* end_schema = "End/1";

std::string read_golden(const std::string& name) {
  const auto path = std::filesystem::path(SPLATBUS_SOURCE_DIR) / "tests" / "golden" / "messages" / (name + ".bin");
  std::ifstream file(path, std::ios::binary);
  EXPECT_TRUE(file) << path;
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Receives mutated messages over a real socket.
class Mutation : public testing::Test {
 protected:
  Mutation()
      : broker_(directory_.address()), subscriber_(bus::Context::create(directory_.address(), "reader"), {"fuzz"}) {
    broker_.await_subscription();
    bus::SlabDescriptor descriptor;
    descriptor.id = slab_id;
    descriptor.name = "maker/frames";
    descriptor.slots = 2;
    descriptor.slot_bytes = 5000;
    slab_ = bus::create_slab_memory(descriptor, false);
  }
  // What comes of a body, if anything: a message with another schema, sent after it, marks its end.
  std::optional<bus::Message> pass(const std::string& body, const std::string& payload) {
    broker_.send({"fuzz", body, payload});
    broker_.send({"fuzz", end_});
    std::optional<bus::Message> result;
    while (auto message = subscriber_.receive(std::chrono::seconds(10))) {
      if (message->header().schema()->string_view() == end_schema) return result;
      result = std::move(message);
    }
    ADD_FAILURE() << "the end did not arrive";
    return result;
  }

  static std::string make_end() {
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(wire::CreateEnvelope(builder, wire::CreateHeaderDirect(builder, end_schema, "fuzz")));
    return {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()};
  }

  // What the broker does for readers over tcp.
  void inline_slabs(const std::string& body, const std::string& payload) const {
    bus::Frames frames;
    frames.topic.rebuild("fuzz", 4);
    frames.body.rebuild(body.data(), body.size());
    frames.payload.rebuild(payload.data(), payload.size());
    frames.has_payload = true;
    std::string why;
    if (bus::verified_header(frames.body, why) == nullptr) return;
    try {
      (void)bus_service::inline_slab_tensors(
          frames, [&](std::uint64_t id) { return id == slab_id ? slab_ : nullptr; },
          bus_service::UnsentBytes(std::size_t{1} << 30));
    } catch (const bus::Error&) {
      ++refused_;
    }
  }

  template <class T>
  void run(const std::string& name, int rounds) {
    const auto golden = read_golden(name);
    const std::string schema = name.substr(0, name.find('.')) + "/1";
    const std::string payload(4096, '\1');
    std::mt19937_64 random(std::hash<std::string>{}(name));
    for (int i = 0; i < rounds; ++i) {
      // Half of them after the tensors were made to point somewhere that exists.
      auto body = golden;
      if (i % 2 == 0) aim(body, random);
      body = mutate(std::move(body), random);
      inline_slabs(body, payload);
      const auto message = pass(body, payload);
      if (!message) {
        ++refused_;
        continue;
      }
      read<T>(*message, schema);
    }
  }

  static void aim(std::string& body, std::mt19937_64& random) {
    auto* header = flatbuffers::GetMutableRoot<wire::Envelope>(body.data())->mutable_header();
    header->mutate_latch(false);  // or most of them would be repeats
    for (flatbuffers::uoffset_t i = 0; i < header->mutable_tensors()->size(); ++i) {
      auto* tensor = header->mutable_tensors()->GetMutableObject(i);
      const bool slab = random() % 2 == 0;
      *tensor->mutable_span() =
          wire::Span(slab ? slab_id : 0, 0, random() % 64 * 8, 8, slab ? wire::Storage::Slab : wire::Storage::Inline);
      tensor->mutable_shape()->Mutate(0, 2);
      tensor->mutable_shape()->Mutate(1, 1);
    }
  }

  template <class T>
  void read(const bus::Message& message, const std::string& schema) {
    try {
      const auto& root = message.root<T>(schema);
      sum_ += root.header()->sequence();
      if (message.header().tensors() == nullptr) return;
      for (const auto* tensor : *message.header().tensors()) {
        const auto view = message.tensor(tensor->name()->str());
        if (!view) continue;
        std::vector<std::byte> copy(view->bytes());
        if (view->copy(copy.data())) {
          ++whole_;
          for (const auto byte : copy) sum_ += static_cast<std::uint64_t>(byte);
        }
        if (view->type() == bus::ElementType::F32) {
          for (const float value : view->as<float>()) sum_ += value > 0 ? 1 : 0;
        }
      }
    } catch (const bus::Error&) {
      ++refused_;
    }
  }

  const std::string end_ = make_end();
  bus_test::TemporaryDirectory directory_;
  bus_test::FakeBroker broker_;
  bus::Subscriber subscriber_;
  std::shared_ptr<bus::Slab> slab_;
  mutable std::size_t refused_ = 0;
  std::size_t whole_ = 0;
  std::uint64_t sum_ = 0;
};

TEST_F(Mutation, NoMutatedMessageDoesHarm) {
  run<wire::EngineFrame>("EngineFrame", 6000);
  run<wire::CaptureInput>("CaptureInput", 4000);
  run<wire::ModelPublished>("ModelPublished", 4000);
  run<wire::ModelInsert>("ModelInsert", 4000);
  run<wire::Heartbeat>("Heartbeat", 2000);
  run<wire::Packet>("Packet.Hello", 2000);
  // Both ways were taken: many were refused, and some tensors survived.
  EXPECT_GT(refused_, 1000u);
  EXPECT_GT(whole_, 100u);
}

}  // namespace
}  // namespace splatbus::fuzz
