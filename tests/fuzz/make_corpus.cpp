// Writes the corpus of every fuzz target, from what the project's own encoders make of a toy model. Run it when a
// format changes: fuzz_corpus tests/fuzz/corpus. Inputs that libFuzzer has found besides are kept.
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <limits>
#include <sstream>

#include "bus/tensor.h"
#include "mcap/writer.h"
#include "splats/file.h"
#include "stream/codecs.h"
#include "stream/page_codec.h"
#include "stream/scene_codec.h"
#include "streamer/share_message.h"
#include "targets/stream_layouts.h"
#include "targets/toy_stream.h"
#include "wire/convert.h"
#include "wire/system_generated.h"
#include "world/world.h"

namespace splatbus::fuzz {
namespace {

using stream::EncodedPacket;
using Buffer = std::vector<std::uint8_t>;

/// An input in the making.
class Maker {
 public:
  template <class T>
  Maker& number(T value) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(&value);
    bytes_.insert(bytes_.end(), bytes, bytes + sizeof(value));
    return *this;
  }
  Maker& byte(unsigned value) { return number(static_cast<std::uint8_t>(value)); }
  template <class Range>
  Maker& add(const Range& bytes) {
    for (const auto byte : bytes) bytes_.push_back(static_cast<std::uint8_t>(byte));
    return *this;
  }
  /// As a PacketLog has it.
  Maker& packet(const EncodedPacket& packet) {
    number(static_cast<std::uint32_t>(packet.packet.size())).number(static_cast<std::uint32_t>(packet.payload.size()));
    return add(packet.packet).add(packet.payload);
  }
  [[nodiscard]] const Buffer& bytes() const { return bytes_; }

 private:
  Buffer bytes_;
};

class Corpus {
 public:
  explicit Corpus(std::filesystem::path folder) : folder_(std::move(folder)) {}

  void write(const std::string& target, const std::string& name, const Maker& input) const {
    std::filesystem::create_directories(folder_ / target);
    std::ofstream file(folder_ / target / name, std::ios::binary | std::ios::trunc);
    file.write(reinterpret_cast<const char*>(input.bytes().data()), static_cast<std::streamsize>(input.bytes().size()));
    if (!file) throw std::runtime_error((folder_ / target / name).string() + ": cannot be written");
  }

 private:
  std::filesystem::path folder_;
};

Buffer read_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}
const std::filesystem::path kGolden = SPLATBUS_SOURCE_DIR "/tests/golden";

stream::QuantizedGaussians some_gaussians(ToyStream& toy, std::size_t count) {
  std::vector<std::uint32_t> columns(count);
  for (std::size_t i = 0; i < count; ++i) columns[i] = static_cast<std::uint32_t>(i);
  return toy.model().observed_gaussians().gather(columns);
}

void write_codecs(const Corpus& corpus) {
  ToyStream toy;
  const auto gaussians = some_gaussians(toy, 40);
  for (const auto codec : {stream::PageCodec::Draco, stream::PageCodec::Planes}) {
    const auto blob = stream::encode_page(gaussians, layout(0), codec);
    corpus.write("page_codec", codec == stream::PageCodec::Draco ? "draco" : "planes",
                 Maker().byte(static_cast<unsigned>(codec)).number(std::uint16_t{40}).add(blob.bytes));
  }
  const auto small = [](unsigned kind, std::size_t count, const stream::Payload& payload) {
    return Maker()
        .byte(kind)
        .number(static_cast<std::uint32_t>(count))
        .number(payload.raw_bytes)
        .number(std::uint16_t{1000})
        .add(payload.bytes);
  };
  const std::vector<std::uint32_t> slots{0, 3, 4, 100, 999};
  corpus.write("delta_codecs", "delta",
               small(6, 5, stream::encode_delta({slots, {{1, -2, 3, 400, -5}, {0, 0, 1, 0, 0}}})));
  corpus.write("delta_codecs", "slots", small(1, 5, stream::encode_slots(slots)));
  corpus.write("delta_codecs", "ids", small(2, 3, stream::encode_ids(std::vector<std::uint64_t>{7, 9, 1ULL << 40U})));
  corpus.write("delta_codecs", "slot_ids", small(3, 5, stream::encode_slot_ids({slots, {0, 7, 7, 0, 0x80000000U}})));
  corpus.write("delta_codecs", "slot_values", small(4, 5, stream::encode_slot_values({slots, {0, 255, 1, 2, 3}})));
  corpus.write("delta_codecs", "chunk", small(5, 40, {stream::encode_chunk(gaussians, layout(0)), 0}));

  const auto one = stream::quantize_scene(toy_scene(1)), two = stream::quantize_scene(toy_scene(2));
  corpus.write("scene_codec", "whole", Maker().byte(0).add(stream::encode_scene(two, nullptr)));
  corpus.write("scene_codec", "change", Maker().byte(1).add(stream::encode_scene(two, &one)));
}

/// What a viewer is sent in some seconds.
std::vector<std::pair<std::string, EncodedPacket>> news() {
  ToyStream toy;
  std::vector<std::pair<std::string, EncodedPacket>> all;
  all.emplace_back("scene", *toy.move());
  for (auto& delta : toy.tick().deltas) all.emplace_back("delta", std::move(delta.packet));
  for (auto& seen : toy.see(100)) all.emplace_back("visibility", std::move(seen.packet));
  all.emplace_back("gone", toy.model().gone_packet(std::vector<std::uint32_t>{0}));
  const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 8, 8, 1));
  all.emplace_back("picture", ToyStream::writer().write(
                                  ToyStream::kEpoch, 0, wire::Body::ProbePicture,
                                  [&](auto& builder) {
                                    return wire::CreateProbePicture(builder, 5, &camera, 256, 0,
                                                                    to_wire(builder, toy_scene(1).light));
                                  },
                                  stream::zstd_compress(Buffer(256), 1)));
  all.emplace_back("keepalive",
                   ToyStream::writer().write(ToyStream::kEpoch, 0, wire::Body::Keepalive,
                                             [](auto& builder) { return wire::CreateKeepalive(builder, 300, 1, 1); }));
  all.emplace_back("bye", ToyStream::writer().write(ToyStream::kEpoch, 0, wire::Body::Bye, [](auto& builder) {
    return wire::CreateByeDirect(builder, "the streamer ends");
  }));
  return all;
}

void write_packets(const Corpus& corpus) {
  Maker join, log;
  join.byte(0);
  for (const EncodedPacket& packet : ToyStream(40).join()) {
    join.packet(packet);
    log.packet(packet);
  }
  corpus.write("follower", "join", join);
  corpus.write("packet_log", "join", log);
  Maker all;
  all.byte(1);
  int number = 0;
  for (auto& [name, packet] : news()) {
    corpus.write("follower", name + std::to_string(number++), Maker().byte(1).packet(packet));
    all.packet(packet);
  }
  corpus.write("follower", "news", all);
  ToyStream toy;
  Maker ancient;
  ancient.byte(1).packet(*toy.move(std::numeric_limits<std::int64_t>::min()));
  corpus.write("follower", "scene_before_all_time", ancient);
}

void write_viewers(const Corpus& corpus) {
  const auto write = [&](wire::Body body, const auto& build) {
    return ToyStream::writer().write(ToyStream::kEpoch, 0, body, build);
  };
  const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 64, 1));
  const std::vector<std::pair<std::string, EncodedPacket>> words{
      {"hello", write(wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "viewer", nullptr, true); })},
      {"pose", write(wire::Body::Pose, [&](auto& b) { return wire::CreatePose(b, &camera); })},
      {"probe", write(wire::Body::Probe, [&](auto& b) { return wire::CreateProbe(b, 7, &camera); })},
      {"held", write(wire::Body::Held, [](auto& b) {
         const std::vector<wire::SequenceRange> missing{{2, 3}};
         const std::vector<wire::PageVersion> lacks{{0, 1}};
         return wire::CreateHeldDirect(b, 9, &missing, 1000, 250'000, &lacks);
       })}};
  for (const auto& [name, packet] : words) {
    corpus.write("packet_gate", name,
                 Maker().byte(3).number(static_cast<std::uint32_t>(packet.packet.size())).add(packet.packet));
    // Said by peer "b", twice, with a second between.
    Maker said;
    said.byte(1);
    for (int i = 0; i < 2; ++i) {
      said.byte(6).byte(1).number(static_cast<std::uint16_t>(packet.packet.size())).add(packet.packet);
      said.byte(8).byte(0).number(std::uint16_t{1000});
    }
    corpus.write("viewer_hub", name, said);
  }
  const auto hello = [](Maker& run, unsigned peer) {
    run.byte(0).byte(peer).byte(1).byte(0).byte(0).byte(0).byte(1).byte(1);
  };
  const auto wait = [](Maker& run, unsigned ms) { run.byte(8).byte(0).number(static_cast<std::uint16_t>(ms)); };
  Maker changing, stuck;
  changing.byte(0);
  stuck.byte(1);
  for (Maker* run : {&changing, &stuck}) {
    for (const unsigned peer : {0U, 1U, 2U, 3U}) hello(*run, peer);
    wait(*run, 500);
  }
  for (unsigned i = 0; i < 4; ++i) {
    changing.byte(13).byte(0).byte(14).byte(40 * i);
    wait(changing, 300);
    // Held: no missing, two lacks, nothing dropped.
    changing.byte(1).byte(1).byte(1).byte(0).byte(2).byte(0).byte(1).byte(0).byte(2).byte(0).byte(1).byte(9);
    changing.number(std::uint64_t{5000}).number(std::uint32_t{250'000}).byte(0);
  }
  for (const unsigned answer : {5U, 10U}) {
    stuck.byte(11).byte(answer);
    wait(stuck, 900);
    stuck.byte(9).byte(0).byte(15).byte(8);
  }
  corpus.write("viewer_hub", "a_world_that_changes", changing);
  corpus.write("viewer_hub", "full_and_gone", stuck);
}

void write_shares(const Corpus& corpus) {
  const auto write = [&](const char* name, const streamer::ShareMessage& message) {
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(
        streamer::write_share(builder, wire::CreateHeaderDirect(builder, "StreamShare", "streamer-2"), message));
    corpus.write("stream_share", name, Maker().add(builder.GetBufferSpan()));
  };
  ToyStream toy;
  streamer::ShareMessage said;
  said.place = {.epoch = toy.model().status().epoch,
                .layout = layout(0).parameters(),
                .mean_step = 1.0F / 8192,
                .version = 1000,
                .encodes = true};
  said.wants = {{4, wire::SharePart::Whole}, {5, wire::SharePart::Parts}, {5, wire::SharePart::Visibility}};
  write("wants", said);
  said.viewers = {.followed = true, .bytes_per_s = 1e6, .held = {3, 4}, .cameras = {look_at({1, 2, 3}, {}, 64, 64, 1)}};
  said.pages = *toy.model().offered();
  said.deltas = toy.tick().deltas;
  said.visibility = toy.see(100);
  write("tick", said);
  for (const stream::OfferedPage& page : *toy.model().offered()) {
    streamer::ShareAnswer answer{.what = {page.page, wire::SharePart::Whole}, .packets = {}};
    for (auto& part : toy.model().page_packets(page.page)) answer.packets.push_back(std::move(part.packet));
    said.answers.push_back(std::move(answer));
  }
  write("answers", said);
}

void write_bus(const Corpus& corpus) {
  for (const char* name : {"EngineFrame", "ModelPublished", "Heartbeat", "ModelInsert"}) {
    const Buffer body = read_file(kGolden / "messages" / (std::string(name) + ".bin"));
    corpus.write("bus_message", name, Maker().byte(8).byte(0).add(body));
    corpus.write("bus_message", std::string(name) + "_in_a_slab", Maker().byte(1).byte(1).add(body));
    const unsigned topic = std::string(name) == "Heartbeat" ? 4 : 0;
    Maker sent;
    sent.byte(topic + 1).number(static_cast<std::uint16_t>(body.size())).add(body);
    sent.byte(topic + 2).number(static_cast<std::uint16_t>(body.size())).add(body);
    sent.number(std::uint16_t{64}).add(Buffer(64, 1));
    corpus.write("bus_relay", name, sent);
  }
  // Register with its descriptors, open by name, open by id, release.
  const auto packet = [](Maker& said, unsigned descriptors, unsigned operation, const std::string& name) {
    said.byte(2 * descriptors).number(static_cast<std::uint16_t>(operation)).number(std::uint32_t{0});
    said.number(std::uint32_t{0}).number(std::uint64_t{7}).number(std::uint64_t{1}).number(std::uint64_t{4096});
    said.number(std::uint64_t{0}).add(name).add(Buffer(192 + 256 - name.size()));
  };
  Maker life;
  packet(life, 1, 1, "maker/frames");
  packet(life, 0, 3, "maker/frames");
  packet(life, 0, 2, "");
  packet(life, 0, 4, "maker/frames");
  corpus.write("slab_registry", "life", life);
  Maker wrong;
  packet(wrong, 2, 1, "maker/frames");
  wrong.byte(1).number(std::uint16_t{7}).add(std::string("garbage"));
  corpus.write("slab_registry", "wrong", wrong);
}

/// A golden message whose tensors have a few bytes behind it.
Buffer recorded(const char* name) {
  Buffer data = read_file(kGolden / "messages" / (std::string(name) + ".bin"));
  auto* tensors = flatbuffers::GetMutableRoot<wire::Envelope>(data.data())->mutable_header()->mutable_tensors();
  std::size_t end = data.size();
  for (flatbuffers::uoffset_t i = 0; i < tensors->size(); ++i) {
    wire::Tensor& tensor = *tensors->GetMutableObject(i);
    std::size_t bytes = bus::element_bytes(tensor.type());
    for (flatbuffers::uoffset_t axis = 0; axis < tensor.shape()->size(); ++axis) {
      tensor.mutable_shape()->Mutate(axis, 2);
      bytes *= 2;
    }
    const std::size_t offset = bus::aligned(end);
    *tensor.mutable_span() = wire::Span(0, 0, offset, bytes, wire::Storage::Inline);
    end = offset + bytes;
  }
  data.resize(end);
  return data;
}

void write_recordings(const Corpus& corpus) {
  const std::filesystem::path path = std::filesystem::temp_directory_path() / "splatbus-fuzz-corpus.mcap";
  for (const int level : {0, 1}) {
    std::filesystem::remove(path);
    mcap::Writer writer(mcap::create_file(path), {.header = {"splatbus", "corpus"}, .compression_level = level});
    const auto schema = writer.add_schema("splatbus.wire.Any", "flatbuffer", std::vector<std::byte>(20));
    for (const char* name : {"SceneUpdate", "CaptureReference", "RelightVisibility"}) {
      const auto channel = writer.add_channel(schema, name, "flatbuffer", {{"latched", "true"}});
      const Buffer data = recorded(name);
      writer.write({.channel_id = channel, .data = std::as_bytes(std::span(data))});
      if (level == 1) writer.close_chunk();
    }
    writer.write(mcap::Metadata{"about", {{"key", "value"}}});
    writer.close();
    const Buffer file = read_file(path);
    corpus.write("recording", level == 0 ? "plain" : "zstd", Maker().add(file));
    if (level == 0) corpus.write("recording", "cut", Maker().add(Buffer(file.begin(), file.end() - 400)));
  }
  std::filesystem::remove(path);
}

void write_files(const Corpus& corpus) {
  corpus.write("ply", "given", Maker().byte(0).add(read_file(kGolden / "splats" / "given.ply")));
  corpus.write("ply", "transform", Maker().byte(1).add(read_file(kGolden / "splats" / "splat_transform.ply")));
  corpus.write("spz", "version3", Maker().byte(0).add(read_file(kGolden / "splats" / "splat_transform3.spz")));
  corpus.write("spz", "version4", Maker().byte(1).add(read_file(kGolden / "splats" / "splat_transform4.spz")));
  for (const char* name : {"demo", "explore"}) {
    const std::filesystem::path path =
        std::filesystem::path(SPLATBUS_SOURCE_DIR) / "launch" / (std::string(name) + ".yaml");
    if (!std::filesystem::exists(path)) continue;
    corpus.write("launch_file", name, Maker().add(read_file(path)).byte(0).add(std::string("trainer.threads=2")));
  }

  const std::filesystem::path folder = std::filesystem::temp_directory_path() / "splatbus-fuzz-corpus-world";
  std::filesystem::remove_all(folder);
  {
    world::World world(folder, {.note = "corpus"});
    for (std::uint64_t p = 0; p < 2; ++p) {
      world::Page page{.key = {.morton = 10 * p, .id = p}, .count = 3, .step = p, .morton_last = 10 * p + 5};
      page.words.assign(std::size_t{91} * page.count, static_cast<std::uint32_t>(p));
      const auto payload = world::encode_page(page, world.layout());
      corpus.write("world_page", "page" + std::to_string(p),
                   Maker().byte(6).add(std::vector<std::uint8_t>(
                       reinterpret_cast<const std::uint8_t*>(payload.data()),
                       reinterpret_cast<const std::uint8_t*>(payload.data()) + payload.size())));
      world.put(page, payload);
      world.commit({.step = p + 1});
    }
    world.mark({.morton = 0, .id = 0}, world::PageMark::Spilled);
    world.remove({.morton = 10, .id = 1});
    world.commit({.step = 3});
  }
  const Buffer segment = read_file(folder / "segments" / "000001.seg");
  const Buffer manifest = read_file(world::manifest_path(folder));
  corpus.write("world_folder", "segment", Maker().byte(0).add(segment));
  corpus.write("world_folder", "both",
               Maker().byte(1).number(static_cast<std::uint16_t>(manifest.size())).add(manifest).add(segment));
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace splatbus::fuzz

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: fuzz_corpus FOLDER\n";
    return 2;
  }
  const splatbus::fuzz::Corpus corpus(argv[1]);
  splatbus::fuzz::write_codecs(corpus);
  splatbus::fuzz::write_packets(corpus);
  splatbus::fuzz::write_viewers(corpus);
  splatbus::fuzz::write_shares(corpus);
  splatbus::fuzz::write_bus(corpus);
  splatbus::fuzz::write_files(corpus);
  splatbus::fuzz::write_recordings(corpus);
}
