// What a viewer in a browser has to make of a stream: writes FOLDER/long.log, short.log and radiance.log, whose colours
// depend on where one looks from (stream/packet_log.h), or large.log of so many Gaussians to measure with, the
// hash of what is held after each message (.hashes, a line each), and of the long one the rows that a GPU would have at
// its end (.rows: for each a record of 32 bytes).
#include <fmt/format.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "../unit/stream/toy_server.h"
#include "stream/follower.h"
#include "stream/gpu_rows.h"
#include "stream/held_hash.h"
#include "stream/packet_log.h"

namespace {

using namespace splatbus;
using stream::test::ToyServer;

class Writer {
 public:
  /// `compared`: with the hashes and rows that are held.
  explicit Writer(const std::string& path, bool compared = true)
      : path_(path),
        compared_(compared),
        log_(path + ".log"),
        hashes_(path + ".hashes"),
        follower_({.name = "writer"}, 0),
        rows_(follower_.replica()) {}

  void add(const stream::EncodedPacket& packet) {
    log_.add(packet.packet, packet.payload);
    follower_.receive(packet.packet, packet.payload, 0);
    if (!compared_) return;
    hashes_ << fmt::format("{:016x}\n", stream::held_hash(follower_.replica().held()));
    take();
  }
  void add(const std::vector<stream::EncodedPacket>& packets) {
    for (const stream::EncodedPacket& packet : packets) add(packet);
  }
  /// Every page that the follower has otherwise, whole.
  void add_pages(stream::StreamModel& model) {
    for (const stream::OfferedPage& page : *model.offered()) {
      const stream::HeldPage* held = follower_.replica().held().find(page.page);
      if (held && held->whole() && held->version == page.version) continue;
      for (const stream::PagePacket& part : model.page_packets(page.page, kPartLanes)) add(part.packet);
    }
  }
  void write_rows() {
    std::ofstream(path_ + ".rows", std::ios::binary)
        .write(reinterpret_cast<const char*>(memory_.data()),
               static_cast<std::streamsize>(memory_.size() * sizeof(stream::GpuRecord)));
  }

 private:
  static constexpr std::size_t kMost = 1U << 20;
  static constexpr std::uint32_t kPartLanes = 2 * stream::kBlockRows;

  /// Objects get their indices in the order in which they are taken.
  void take() {
    std::vector<std::uint32_t> rows, colors;
    std::vector<stream::GpuRecord> records;
    rows_.take_records(kMost, rows, records);
    memory_.resize(rows_.capacity());
    for (std::size_t k = 0; k < rows.size(); ++k) memory_[rows[k]] = records[k];
    rows_.take_colors(kMost, rows, colors);
    for (std::size_t k = 0; k < rows.size(); ++k) memory_[rows[k]].color = colors[k];
  }
  std::string path_;
  bool compared_;
  stream::PacketLog log_;
  std::ofstream hashes_;
  stream::Follower follower_;
  stream::GpuRows rows_;
  std::vector<stream::GpuRecord> memory_;
};

Light light_at(float turn) {
  Light light{.sun_direction = glm::normalize(glm::vec3(std::cos(turn), 1, std::sin(turn))),
              .sun_irradiance = {3, 2.5F, 2},
              .background = {0.2F, 0.4F, 0.8F},
              .sources = {}};
  light.ambient_sh[0] = {0.5F, 0.6F, 0.7F};
  light.sources.push_back({.id = 4, .position = {1, 1, 0}, .intensity = {2, 1, 0}});
  return light;
}

void write(Writer& writer, std::size_t gaussians, int ticks, Appearance appearance = Appearance::Transfer) {
  ToyServer server(21, gaussians, appearance);
  server.scene.objects[7] = ObjectTransform(Rigid{.translation = {0, 1, 0}});
  server.scene.light = light_at(0);
  server.change_scene();
  writer.add(server.stream.layout_packet());
  writer.add(*server.stream.scene_packet());
  writer.add(server.stream.manifest_packets(*server.stream.offered(), {}, true));
  writer.add_pages(server.stream);
  for (int tick = 1; tick <= ticks; ++tick) {
    server.train(0.02F);
    if (tick % 4 == 1) server.remove(gaussians / 20);
    if (tick % 4 == 3) server.insert(gaussians / 20);
    if (tick % 5 == 0) server.scene.light = light_at(0.1F * static_cast<float>(tick));
    server.scene.objects[7].rigid.translation.x = 0.05F * static_cast<float>(tick);
    writer.add(server.tick());
    writer.add_pages(server.stream);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2 && argc != 3) {
    std::fputs("usage: write_logs FOLDER [GAUSSIANS]\n", stderr);
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  std::filesystem::create_directories(folder);
  if (argc == 3) {
    Writer large((folder / "large").string(), false);
    write(large, std::stoul(argv[2]), 0);
    return testing::Test::HasFailure() ? 1 : 0;
  }
  Writer longer((folder / "long").string());
  write(longer, 20'000, 12);
  longer.write_rows();
  Writer radiant((folder / "radiance").string());
  write(radiant, 8'000, 6, Appearance::Radiance);
  Writer shorter((folder / "short").string());
  write(shorter, 60, 8);
  return testing::Test::HasFailure() ? 1 : 0;
}
