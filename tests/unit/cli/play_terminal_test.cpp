// `splatbus play` at a terminal: pausing, stepping, and the terminal after it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "../bus/bus_fixture.h"
#include "mcap/writer.h"
#include "program_in_terminal.h"
#include "recording_file.h"

namespace splatbus::cli {
namespace {

using bus_test::eventually;
using namespace std::chrono_literals;

constexpr std::uint64_t kNumbers = 250, kApartNs = 20'000'000;  // 5 s in all

std::vector<std::byte> probe(std::uint64_t number) {
  flatbuffers::FlatBufferBuilder builder;
  const auto header = wire::CreateHeaderDirect(builder, "ViewerProbe/1", "viewer", number + 1, 77, 0, 1);
  const wire::Camera camera;
  builder.Finish(wire::CreateViewerProbe(builder, header, number, &camera));
  const auto* const bytes = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {bytes, bytes + builder.GetSize()};
}

class PlayTerminal : public bus_test::BusTest {
 protected:
  PlayTerminal() : reader_(connect("reader"), {"numbers"}) {
    mcap::Writer writer(mcap::create_file(path()), {});
    const auto channel = writer.add_channel(0, "numbers", "flatbuffer", {});
    for (std::uint64_t i = 0; i < kNumbers; ++i) {
      const auto data = probe(i);
      writer.write(mcap::Message{
          .channel_id = channel, .log_time = (i + 1) * kApartNs, .publish_time = (i + 1) * kApartNs, .data = data});
    }
    writer.close();
    EXPECT_TRUE(reader_.wait_connected(bus_test::patience));
  }
  [[nodiscard]] std::string path() const { return directory_.path() + "/numbers.mcap"; }
  [[nodiscard]] std::vector<std::string> command() const {
    return {SPLATBUS_BIN_DIR "/splatbus", "play", path(), "--bus", directory_.address().text()};
  }

  /// Until so many more have been heard.
  bool hear(std::uint64_t more) {
    const std::uint64_t wanted = heard_ + more;
    return eventually([&] {
      while (heard_ < wanted && reader_.receive(1ms)) ++heard_;
      return heard_ == wanted;
    });
  }
  /// Whether nothing comes for half a second, in which 25 messages would have.
  bool is_silent() { return reader_.receive(500ms) == std::nullopt; }
  /// Types a space, and hears what was on its way.
  bool pause(ProgramInTerminal& terminal) {
    terminal.type(" ");
    const bool said = terminal.read_until("paused");
    while (reader_.receive(200ms)) ++heard_;
    return said;
  }

  bus::Subscriber reader_;
  std::uint64_t heard_ = 0;
};

TEST_F(PlayTerminal, SpacePausesAndGoesOnAndKeysPlayOneMessage) {
  ProgramInTerminal terminal(command());
  ASSERT_TRUE(hear(5));
  EXPECT_FALSE(terminal.is_as_it_was());
  ASSERT_TRUE(pause(terminal)) << terminal.all();
  EXPECT_TRUE(is_silent());
  for (const char* key : {"s", "\x1b[C", "\x1bOC"}) {
    terminal.type(key);
    EXPECT_TRUE(hear(1)) << key;
    EXPECT_TRUE(is_silent()) << key;
  }
  terminal.type("x\x1b[A\x1b[D");  // keys of no meaning
  EXPECT_TRUE(is_silent());
  terminal.type("sss");
  EXPECT_TRUE(hear(3));
  EXPECT_TRUE(is_silent());
  const std::uint64_t left = kNumbers - heard_;
  const std::int64_t on_ns = bus::now_ns();
  terminal.type(" ");
  EXPECT_TRUE(hear(left)) << heard_;
  // Neither the pause nor the steps are made up for: each comes a step after the one before.
  EXPECT_GT(bus::now_ns() - on_ns, static_cast<std::int64_t>((left - 1) * kApartNs));
  EXPECT_EQ(reader_.lost(), 0U);
  EXPECT_TRUE(terminal.read_until("played " + std::to_string(kNumbers) + " messages")) << terminal.all();
  EXPECT_EQ(terminal.wait(), 0);
  EXPECT_TRUE(terminal.is_as_it_was());
}

TEST_F(PlayTerminal, SignalsEndAPauseAndGiveTheTerminalBack) {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT}) {
    ProgramInTerminal terminal(command());
    ASSERT_TRUE(hear(3));
    ASSERT_TRUE(pause(terminal)) << terminal.all();
    EXPECT_FALSE(terminal.is_as_it_was());
    terminal.send(signal);
    EXPECT_EQ(terminal.wait(), signal == SIGQUIT ? -SIGQUIT : 0) << terminal.all();
    EXPECT_TRUE(terminal.is_as_it_was()) << signal;
  }
}

TEST_F(PlayTerminal, WhereNoTerminalIsNothingIsAskedOfIt) {
  // The shell's own terminal stays as it is, and what is typed there is not read.
  std::vector<std::string> quiet{"/bin/sh", "-c", "exec \"$@\" </dev/null", "sh"};
  for (const std::string& one : command()) quiet.push_back(one);
  ProgramInTerminal terminal(quiet);
  ASSERT_TRUE(hear(5));
  EXPECT_TRUE(terminal.is_as_it_was());
  terminal.type(" ");
  EXPECT_TRUE(hear(30));
}

}  // namespace
}  // namespace splatbus::cli
