// What a viewer's replica costs: memory of the heap a Gaussian, what GPU rows add, and how fast pages and changes are
// applied.
#include <fmt/format.h>
#include <malloc.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <random>
#include <vector>

#include "gaussians/model.h"
#include "stream/follower.h"
#include "stream/gpu_rows.h"
#include "stream/stream_model.h"

namespace {

using namespace splatbus;

double heap_mb() {
  const auto info = ::mallinfo2();
  return static_cast<double>(info.uordblks + info.hblkhd) / 1e6;
}

double ms_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

GaussiansBuffer floor_of(std::size_t count) {
  GaussiansBuffer model(ParameterLayout{}, count);
  std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (std::size_t i = 0; i < count; ++i) {
    const auto set = [&](int channel, float value) {
      model.parameters[static_cast<std::size_t>(channel) * model.stride() + i] = value;
    };
    const float x = 5 * uniform(random), z = 5 * uniform(random);
    set(0, x), set(1, 0.3F * std::sin(2 * x)), set(2, z);
    for (int c = 3; c < 6; ++c) set(c, -5 + 0.5F * uniform(random));
    set(6, 1);
    for (int c = 7; c < 10; ++c) set(c, 0.2F * uniform(random));
    for (int c = 11; c < 14; ++c) set(c, 0.5F + 0.3F * uniform(random));
    for (int c = 14; c < 41; ++c) set(c, 0.05F * uniform(random));
    model.normal[model.stride() + i] = 1;
    model.visibility[i] = uniform(random) > 0 ? 1.0F : 0.0F;
    model.gaussian_id[i] = i + 1;
  }
  return model;
}

}  // namespace

int main(int argc, char** argv) {
  std::size_t gaussians = 1'000'000;
  CLI::App app("Memory and speed of a viewer's replica", "bench_replica");
  app.add_option("--gaussians", gaussians)->capture_default_str();
  CLI11_PARSE(app, argc, argv);

  GaussiansBuffer model = floor_of(gaussians);
  stream::StreamModel server(stream::PacketWriter("bench", 1), 1);
  server.observe(model.view());
  server.reset_to_target();
  std::vector<stream::EncodedPacket> packets;
  for (const stream::OfferedPage& page : *server.offered()) {
    for (stream::PagePacket& part : server.page_packets(page.page)) packets.push_back(std::move(part.packet));
  }
  for (std::size_t i = 0; i < gaussians; i += 10) model.parameters[11 * model.stride() + i] += 0.05F;
  server.observe(model.view());
  server.make_tick(1e9, {});
  stream::StreamUpdate update = server.take_update();

  const double before_mb = heap_mb();
  auto follower = std::make_unique<stream::Follower>(stream::FollowerOptions{.name = "bench"}, 0);
  stream::GpuRows rows(follower->replica());
  const auto take = [&](const stream::EncodedPacket& packet) { follower->receive(packet.packet, packet.payload, 0); };
  take(server.layout_packet());
  auto begin = std::chrono::steady_clock::now();
  for (const stream::EncodedPacket& packet : packets) take(packet);
  const double pages_ms = ms_since(begin), held_mb = heap_mb() - before_mb;
  begin = std::chrono::steady_clock::now();
  for (const stream::DeltaPacket& delta : update.deltas) take(delta.packet);
  const double deltas_ms = ms_since(begin);
  std::vector<std::uint32_t> changed;
  std::vector<stream::GpuRecord> records;
  begin = std::chrono::steady_clock::now();
  rows.take_records(gaussians * 2, changed, records);
  const double records_ms = ms_since(begin);
  const std::size_t count = follower->replica().count();
  fmt::print(
      R"({{"gaussians": {}, "heap_mb": {:.1f}, "bytes_a_gaussian": {:.1f}, "pages_ms": {:.0f}, "deltas_ms": {:.0f}, )"
      R"("records_ms": {:.0f}, "records": {}}})"
      "\n",
      count, held_mb, 1e6 * held_mb / static_cast<double>(count), pages_ms, deltas_ms, records_ms, changed.size());
  return 0;
}
