#include "bus/frames.h"

#include <flatbuffers/flatbuffers.h>
#include <fmt/format.h>

#include <cstring>
#include <utility>

#include "bus/connection_watch.h"

namespace splatbus::bus {
namespace {

constexpr std::size_t max_name_bytes = 256;
constexpr std::size_t max_tensors = 512;
constexpr std::size_t frame_alignment = 8;

zmq::message_t share_frame(const zmq::message_t& frame) {
  zmq::message_t copy;
  // ZeroMQ counts the reference inside of the frame; its bytes stay as they are.
  copy.copy(const_cast<zmq::message_t&>(frame));
  return copy;
}

// ZeroMQ hands out small frames in place within its receive buffer, at any address.
void align(zmq::message_t& frame) {
  if (reinterpret_cast<std::uintptr_t>(frame.data()) % frame_alignment == 0) return;
  zmq::message_t copy(frame.data(), frame.size());
  frame = std::move(copy);
}

bool too_long(const flatbuffers::String* text) {
  return text != nullptr && text->size() > max_name_bytes;
}

}  // namespace

Frames Frames::share() const {
  return {share_frame(topic), share_frame(body), share_frame(payload), has_payload};
}

RecvResult receive_frames(zmq::socket_ref socket, Frames& frames, std::string& why) {
  frames = Frames();
  if (!socket.recv(frames.topic, zmq::recv_flags::dontwait)) return RecvResult::Nothing;
  // The parts of a message arrive together or not at all, so the others are there.
  std::size_t count = 1;
  bool more = frames.topic.more();
  while (more) {
    zmq::message_t surplus;
    ++count;
    frames.has_payload = count == 3;
    auto& frame = count == 2 ? frames.body : count == 3 ? frames.payload : surplus;
    if (!socket.recv(frame, zmq::recv_flags::dontwait)) break;
    more = frame.more();
  }
  if (count < 2 || count > 3) {
    why = fmt::format("{} frames instead of 2 or 3", count);
    return RecvResult::Malformed;
  }
  if (frames.topic.empty() || frames.topic.size() > max_topic_bytes || frames.body.size() > max_body_bytes) {
    why = fmt::format("a topic of {} bytes and a body of {}", frames.topic.size(), frames.body.size());
    return RecvResult::Malformed;
  }
  align(frames.body);
  align(frames.payload);
  return RecvResult::Complete;
}

void send_frames(zmq::socket_ref socket, Frames frames) {
  using zmq::send_flags;
  const auto rest = frames.has_payload ? send_flags::sndmore | send_flags::dontwait : send_flags::dontwait;
  if (!socket.send(frames.topic, send_flags::sndmore | send_flags::dontwait)) return;
  socket.send(frames.body, rest);
  if (frames.has_payload) socket.send(frames.payload, send_flags::dontwait);
}

const wire::Header* verified_header(const zmq::message_t& body, std::string& why) {
  flatbuffers::Verifier::Options limits;
  limits.max_depth = 8;
  limits.max_tables = max_tensors + 8;
  flatbuffers::Verifier verifier(body.data<std::uint8_t>(), body.size(), limits);
  if (!verifier.VerifyBuffer<wire::Envelope>(nullptr)) {
    why = fmt::format("its {} bytes do not verify as an Envelope", body.size());
    return nullptr;
  }
  const auto* header = flatbuffers::GetRoot<wire::Envelope>(body.data())->header();
  if (header->source()->size() == 0 || too_long(header->source()) || too_long(header->schema()) ||
      too_long(header->latch_key())) {
    why = "its header holds an empty or overlong name";
    return nullptr;
  }
  return header;
}

std::string printable(std::string_view text, std::size_t limit) {
  std::string result(text.substr(0, limit));
  for (char& c : result) {
    if (c < 0x20 || c > 0x7e) c = '?';
  }
  if (text.size() > limit) result += "...";
  return result;
}

namespace {

// Bulk data rides in slabs on this machine, so that many small messages may wait; over tcp they carry it.
constexpr int local_high_water_mark = 4096;
constexpr int remote_high_water_mark = 256;
constexpr int linger_ms = 500;
constexpr int reconnect_ms = 50;
constexpr int reconnect_max_ms = 500;
constexpr int connect_ms = 3000;  // who is not let in now may be in a moment

}  // namespace

void configure_socket(zmq::socket_t& socket, bool local) {
  const int high_water_mark = local ? local_high_water_mark : remote_high_water_mark;
  socket.set(zmq::sockopt::sndhwm, high_water_mark);
  socket.set(zmq::sockopt::rcvhwm, high_water_mark);
  socket.set(zmq::sockopt::linger, linger_ms);
  socket.set(zmq::sockopt::maxmsgsize, max_frame_bytes);
  socket.set(zmq::sockopt::reconnect_ivl, reconnect_ms);
  socket.set(zmq::sockopt::reconnect_ivl_max, reconnect_max_ms);
  if (local) return;
  socket.set(zmq::sockopt::connect_timeout, connect_ms);
  watch_connections(socket);
}

}  // namespace splatbus::bus
