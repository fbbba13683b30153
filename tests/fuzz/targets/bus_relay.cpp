// A broker and a peer of this machine that publishes what it likes: messages of one to three frames. What a reader gets
// of them verifies, and a message after them arrives.
#include <spdlog/spdlog.h>

#include <filesystem>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "bus/broker.h"
#include "bus/frames.h"
#include "target.h"
#include "wire/system_generated.h"

namespace {

namespace bus = splatbus::bus;
namespace wire = splatbus::wire;
using splatbus::fuzz::Bytes;
using splatbus::fuzz::require;

constexpr const char* kEnd = "fuzz/end";
constexpr int kPatienceMs = 60'000;

std::string temporary_folder() {
  std::string name = (std::filesystem::temp_directory_path() / "fuzz-bus-XXXXXX").string();
  require(::mkdtemp(name.data()) != nullptr, "a folder");
  return name;
}

class Bus {
 public:
  Bus() {
    spdlog::set_level(spdlog::level::off);
    options_.address = bus::Address::parse("ipc://" + folder_);
    options_.max_held_messages = 64;
    options_.max_held_bytes = std::size_t{1} << 20;
    broker_ = std::make_unique<splatbus::bus_service::Broker>(options_);
    broker_->start();
    for (zmq::socket_t* socket : {&publisher_, &reader_}) {
      socket->set(zmq::sockopt::linger, 0);
      socket->set(zmq::sockopt::rcvhwm, 0);
      socket->set(zmq::sockopt::sndhwm, 0);
    }
    publisher_.connect(options_.address.publish_endpoint());
    zmq::message_t subscription;
    require(publisher_.recv(subscription).has_value(), "the broker listens");
    reader_.connect(options_.address.subscribe_endpoint());
    reader_.set(zmq::sockopt::subscribe, "");
    // Whoever has just subscribed misses what was under way.
    patience_ms_ = 50;
    do {
      send_end();
    } while (!read_to_end());
    patience_ms_ = kPatienceMs;
  }
  ~Bus() {
    broker_.reset();
    std::filesystem::remove_all(folder_);
  }
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;

  void send(const std::vector<Bytes>& frames) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const auto more = i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none;
      (void)publisher_.send(zmq::buffer(frames[i].data(), frames[i].size()), more);
    }
  }
  void send_end() {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "End/1", "fuzz-end", ++ends_, 1);
    builder.Finish(wire::CreateEnvelope(builder, header));
    const std::string topic = kEnd;
    send({{reinterpret_cast<const std::uint8_t*>(topic.data()), topic.size()},
          {builder.GetBufferPointer(), builder.GetSize()}});
  }
  /// Whether the last end has come.
  bool read_to_end() {
    while (true) {
      zmq_pollitem_t item{reader_.handle(), 0, ZMQ_POLLIN, 0};
      zmq_poll(&item, 1, patience_ms_);
      bus::Frames frames;
      std::string why;
      const auto result = bus::receive_frames(reader_, frames, why);
      if (result == bus::RecvResult::Nothing) return false;
      require(result == bus::RecvResult::Complete, "what is relayed is whole");
      const auto* header = bus::verified_header(frames.body, why);
      require(header != nullptr, "what is relayed verifies");
      flatbuffers::Verifier verifier(frames.body.data<std::uint8_t>(), frames.body.size(), 8, 4096);
      const auto topic = frames.topic_text();
      require(topic != "sys/heartbeat" || verifier.VerifyBuffer<wire::Heartbeat>(nullptr), "a heartbeat is one");
      require(topic != "fuzz" || header->source()->string_view() != "bus", "nobody else is the broker");
      if (topic == kEnd && header->source()->string_view() == "fuzz-end" && header->sequence() == ends_) return true;
    }
  }

 private:
  const std::string folder_ = temporary_folder();
  splatbus::bus_service::BrokerOptions options_;
  std::unique_ptr<splatbus::bus_service::Broker> broker_;
  zmq::context_t context_;
  zmq::socket_t publisher_{context_, zmq::socket_type::xpub}, reader_{context_, zmq::socket_type::sub};
  std::uint64_t ends_ = 0;
  long patience_ms_ = kPatienceMs;
};

}  // namespace

SPLATBUS_FUZZ_TARGET(bus_relay, bytes) {
  static Bus bus;
  splatbus::fuzz::Input input(bytes);
  while (!input.empty()) {
    const auto choice = input.number();
    static constexpr const char* kTopics[] = {"fuzz", "sys/heartbeat", "sys/liveness", "scene/state"};
    const std::string topic = kTopics[choice / 4 % 4];
    std::vector<Bytes> frames{{reinterpret_cast<const std::uint8_t*>(topic.data()), topic.size()}};
    if (choice >= 128) frames[0] = input.take(input.number());
    for (int i = 0; i < choice % 4; ++i) frames.push_back(input.take(input.number<std::uint16_t>()));
    bus.send(frames);
  }
  bus.send_end();
  require(bus.read_to_end(), "the broker goes on");
}
