#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "../bus/bus_fixture.h"
#include "bus/file_descriptor.h"
#include "bus/keys.h"
#include "checks.h"
#include "child_process.h"
#include "gpu_usage.h"
#include "supervised_run.h"
#include "verbs.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using Verdict = Check::Verdict;

/// A port of 127.0.0.1 that this process listens on.
class TakenPort {
 public:
  TakenPort() : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in name{
        .sin_family = AF_INET, .sin_port = 0, .sin_addr = {.s_addr = htonl(INADDR_LOOPBACK)}, .sin_zero = {}};
    socklen_t size = sizeof name;
    EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<sockaddr*>(&name), size), 0);
    EXPECT_EQ(::listen(socket_.get(), 1), 0);
    EXPECT_EQ(::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&name), &size), 0);
    port_ = ntohs(name.sin_port);
  }
  [[nodiscard]] std::uint16_t port() const { return port_; }
  void close() { socket_.reset(); }

 private:
  bus::FileDescriptor socket_;
  std::uint16_t port_ = 0;
};

TEST(Doctor, NamesWhoHasAPort) {
  TakenPort taken;
  EXPECT_EQ(listener_of(taken.port()), ::getpid());
  const Check check = check_port("127.0.0.1", taken.port(), "the gateway");
  EXPECT_EQ(check.verdict, Verdict::Fail);
  EXPECT_THAT(check.found, HasSubstr(fmt::format("(process {})", ::getpid())));
  EXPECT_THAT(check.advice, HasSubstr("give the gateway another port"));
  taken.close();
  EXPECT_EQ(check_port("127.0.0.1", taken.port(), "the gateway").verdict, Verdict::Ok);
  EXPECT_EQ(listener_of(taken.port()), 0);
}

TEST(Doctor, RefusesAddressesThatAreNotHere) {
  EXPECT_EQ(check_port("192.0.2.1", 7680, "the gateway").verdict, Verdict::Fail) << "of TEST-NET-1";
}

TEST(Doctor, LooksWhoMayEnterTheBusFolder) {
  const PrivateBusFolder room;
  const std::string folder = (room.path() / "bus").string();
  const auto check = [&] { return check_bus_folder(bus::Address::parse("ipc://" + folder)); };
  EXPECT_EQ(check().verdict, Verdict::Ok) << "it is made at the first start";
  EXPECT_FALSE(fs::exists(folder)) << "and not by looking";

  fs::create_directory(folder);
  ::chmod(folder.c_str(), 0700);
  EXPECT_EQ(check().verdict, Verdict::Ok);
  ::chmod(folder.c_str(), 0755);
  EXPECT_EQ(check().verdict, Verdict::Warn) << "empty: the next start closes it";
  std::ofstream(folder + "/notes.txt") << "mine";
  EXPECT_EQ(check().verdict, Verdict::Fail) << "somebody's folder, named by mistake";
  EXPECT_THAT(check().advice, HasSubstr("chmod 0700 " + folder));
  struct stat status {};
  ::stat(folder.c_str(), &status);
  EXPECT_EQ(status.st_mode & 0777U, 0755U) << "looking changes nothing";
  std::ofstream(folder + "/lock") << "";
  EXPECT_EQ(check().verdict, Verdict::Warn) << "a bus's own";
  ::chmod(folder.c_str(), 0500);
  EXPECT_EQ(check().verdict, Verdict::Fail);
  ::chmod(folder.c_str(), 0700);
  fs::remove_all(folder);
  fs::create_directory_symlink(room.path(), folder);
  EXPECT_THAT(check().found, HasSubstr("not a folder"));
}

TEST(Doctor, ReadsKeysAsTheProgramsDo) {
  const PrivateBusFolder room;
  const fs::path folder = room.path() / "keys";
  ASSERT_EQ(check_keys(folder).size(), 1U);
  EXPECT_EQ(check_keys(folder).front().verdict, Verdict::Ok) << "none are needed on one machine";
  const bus::KeyPair pair = bus::make_key_pair();
  bus::write_key_file(folder / "server.key", pair);
  bus::write_allow_list(folder / "allowed", {{"me", pair.public_key, bus::parse_rights("view").value()}});
  EXPECT_EQ(check_keys(folder).front().verdict, Verdict::Ok);
  EXPECT_THAT(check_keys(folder).front().found, HasSubstr("1 of our own, 1 allowed"));
  ::chmod((folder / "server.key").c_str(), 0644);
  EXPECT_EQ(check_keys(folder).front().verdict, Verdict::Fail);
  EXPECT_THAT(check_keys(folder).front().found, HasSubstr("server.key"));
  ::chmod((folder / "server.key").c_str(), 0600);
  std::ofstream(folder / "allowed") << "nonsense\n";
  EXPECT_EQ(check_keys(folder).front().verdict, Verdict::Fail);
}

TEST(Doctor, FindsThePageAndThePrograms) {
  const PrivateBusFolder room;
  const fs::path programs = room.path() / "bin", page = room.path() / "share/splatbus/web";
  EXPECT_EQ(check_page(programs).verdict, Verdict::Warn);
  EXPECT_THAT(check_page(programs).advice, HasSubstr("./splatbus build"));
  fs::create_directories(page);
  std::ofstream(page / "index.html") << "<html>";
  EXPECT_EQ(check_page(programs).verdict, Verdict::Ok);
  EXPECT_EQ(check_programs(programs).verdict, Verdict::Fail);
  EXPECT_THAT(check_programs(programs).found, HasSubstr("splatbus-trainer"));
}

TEST(Doctor, SaysHowMuchDiskThereIs) {
  const PrivateBusFolder room;
  const Check check = check_disk("logs", room.path() / "not/there/yet");
  EXPECT_THAT(check.found, HasSubstr("free in " + room.path().string()));
  EXPECT_EQ(check_disk("logs", "/proc").verdict, Verdict::Fail) << "nothing is free there";
}

TEST(GpuUsage, ReadsWhatNvidiaSmiPrints) {
  const auto gpus =
      parse_gpus("NVIDIA H100 80GB HBM3, 550.54.15, 37, 1024, 81559\nNVIDIA T4, 535.1, [N/A], 0, 15360\nno\n");
  ASSERT_EQ(gpus.size(), 2U);
  EXPECT_EQ(gpus[0].name, "NVIDIA H100 80GB HBM3");
  EXPECT_EQ(gpus[0].driver, "550.54.15");
  EXPECT_EQ(gpus[0].busy_percent, 37);
  EXPECT_EQ(gpus[0].used_mib, 1024);
  EXPECT_EQ(gpus[0].total_mib, 81559);
  EXPECT_EQ(gpus[1].busy_percent, 0);
  EXPECT_EQ(parse_gpu_memory("12, 500\n7, 20\n12, 4\n"), (std::map<std::uint32_t, double>{{7, 20}, {12, 504}}));
  EXPECT_TRUE(parse_gpus("").empty());
}

/// Exit status and verdicts by name, of the verb as a user runs it.
std::pair<int, std::map<std::string, std::string>> run_doctor(const std::vector<std::string>& arguments) {
  CLI::App app;
  Action action;
  add_doctor_verb(app, action);
  std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
  reversed.insert(reversed.end(), {"--json", "doctor"});
  app.parse(reversed);
  testing::internal::CaptureStdout();
  const int status = action();
  std::istringstream lines(testing::internal::GetCapturedStdout());
  std::map<std::string, std::string> verdicts;
  for (std::string line; std::getline(lines, line);) {
    const auto json = nlohmann::json::parse(line);
    verdicts[json.at("check")] = json.at("verdict");
    EXPECT_TRUE(json.at("verdict") == "ok" || !json.at("advice").get<std::string>().empty()) << line;
  }
  return {status, verdicts};
}

TEST(Doctor, ExitsWith1WhenSomethingFails) {
  const PrivateBusFolder room;
  TakenPort taken;
  const std::string port = std::to_string(taken.port());
  const std::string bus = "ipc://" + (room.path() / "bus").string();
  const auto [failed, with_port] = run_doctor({"--bus", bus, "--port", port});
  EXPECT_EQ(failed, 1);
  EXPECT_EQ(with_port.at("port " + port), "fail");
  EXPECT_EQ(with_port.at("bus folder"), "ok");
  EXPECT_EQ(with_port.at("bus"), "ok");
  taken.close();
  const auto [status, verdicts] = run_doctor({"--bus", bus, "--port", port});
  EXPECT_EQ(verdicts.at("port " + port), "ok");
  const bool fails =
      std::any_of(verdicts.begin(), verdicts.end(), [](const auto& entry) { return entry.second == "fail"; });
  EXPECT_EQ(status, fails ? 1 : 0);

  std::ofstream(room.path() / "ports.yaml")
      << "services:\n  - name: bus\n  - name: gateway\n    parameters:\n      http: 127.0.0.1:7999\n"
         "  - name: streamer\n    parameters:\n      tcp: tcp://*:7600\n";
  const auto named = run_doctor({"--bus", bus, "--launch", (room.path() / "ports.yaml").string()}).second;
  EXPECT_TRUE(named.contains("port 7999"));
  EXPECT_TRUE(named.contains("port 7600"));
  EXPECT_FALSE(named.contains("port 7680"));

  std::ofstream(room.path() / "asked.yaml") << "arguments: {port: {type: integer}}\nservices:\n  - name: streamer\n"
                                               "    parameters: {tcp: \"tcp://*:${port}\"}\n";
  const std::string asked = (room.path() / "asked.yaml").string();
  EXPECT_TRUE(run_doctor({"--bus", bus, "--launch", asked, "port=7601"}).second.contains("port 7601"));
  EXPECT_THROW(run_doctor({"--bus", bus, "port=7601"}), CLI::RequiresError) << "of which file?";
}

class DoctorOnABus : public bus_test::BusTest {};

TEST_F(DoctorOnABus, NamesWhoSpeaksAnotherProtocol) {
  const ChildProcess other(SPLATBUS_BIN_DIR "/swap-test-other-protocol", {directory_.address().text()}, {});
  Check check;
  ASSERT_TRUE(bus_test::eventually([&] {
    check = check_bus(directory_.address());
    return check.verdict == Verdict::Fail;
  }));
  EXPECT_THAT(check.found, HasSubstr("test.next (" + std::to_string(kProtocolVersion + 1) + ")"));
  EXPECT_EQ(check.advice, "swap to a program of our version: splatbus swap test --program PATH")
      << "a successor has no name to be restarted by";
}

}  // namespace
}  // namespace splatbus::cli
