#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <utility>

#include "command.h"
#include "figures.h"
#include "metrics/image_io.h"
#include "pipeline.h"
#include "splats/file.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

Json read_json(const fs::path& path) {
  std::ifstream file(path);
  return Json::parse(file, nullptr, false);
}

void expect_finite(const Json& summary, const std::vector<std::string>& keys) {
  for (const std::string& key : keys) {
    ASSERT_TRUE(summary.contains(key)) << key;
    EXPECT_TRUE(summary[key].is_number()) << key << ": " << summary[key];  // JSON has no infinite numbers: null
  }
}

TEST(Measure, DemoWritesItsFigures) {
  const PrivateBusFolder folder;
  const fs::path launch_file = folder.path() / "small.yaml";
  std::ofstream(launch_file) << Pipeline::launch_file();
  const fs::path out = folder.path() / "demo";
  const Answer answer = splatbus_command(
      {"demo", "--seconds", "5", "--seed", "3", "--json", "--launch", launch_file.string(), "--out", out.string()},
      "splatbus-demo");
  std::ostringstream log;
  log << std::ifstream(out / "services.log").rdbuf();
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines) << log.str();

  const Json summary = read_json(out / "summary.json");
  ASSERT_TRUE(summary.is_object());
  expect_finite(summary, {"first_picture_s", "gaussians", "ssim_server", "psnr_server", "flip_server", "ssim_viewer",
                          "psnr_viewer", "flip_viewer", "steps_per_s", "wire_mbps_mean", "wire_mbps_peak", "seconds",
                          "seed", "cameras"});
  EXPECT_FALSE(summary.contains("note")) << summary["note"];
  EXPECT_EQ(answer.json().back(), summary) << "what is printed is what is written";
  EXPECT_EQ(summary["seconds"], 5);
  EXPECT_EQ(summary["seed"], 3);
  EXPECT_GT(summary["first_picture_s"], 0);
  for (const char* key : {"ssim_server", "ssim_viewer"}) {
    EXPECT_GT(summary[key], 0.5) << key;
    EXPECT_LE(summary[key], 1) << key;
  }
  EXPECT_GT(summary["steps_per_s"], 0);
  EXPECT_GE(summary["wire_mbps_peak"], summary["wire_mbps_mean"]);

  const std::size_t written = splats::read_file((out / "model.ply").string()).gaussians.count();
  const auto gaussians = summary["gaussians"].get<std::size_t>();
  EXPECT_LE(written, gaussians) << "those of toys that are gone do not show";
  EXPECT_GT(written, gaussians / 2);
  const cv::Mat sheet = metrics::read_png((out / "contact_sheet.png").string());
  EXPECT_GT(sheet.cols, 4 * 160) << "four pictures a row";
  EXPECT_GT(sheet.rows, 4 * 160) << "four held-out cameras";
}

TEST(Measure, EvalFixedWritesItsFigures) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  const Answer answer = splatbus_command({"eval",
                                          "fixed",
                                          "--cameras",
                                          "3",
                                          "--size",
                                          "48",
                                          "--iterations",
                                          "20",
                                          "--every",
                                          "10",
                                          "--views",
                                          "2",
                                          "--input-cameras",
                                          "4",
                                          "--input-size",
                                          "48",
                                          "--budget",
                                          "3000",
                                          "--timeout",
                                          "90",
                                          "--json",
                                          "--ready-gaussians",
                                          "100",
                                          "--out",
                                          out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);

  std::ifstream csv(out / "figures.csv");
  std::string line;
  ASSERT_TRUE(std::getline(csv, line));
  EXPECT_EQ(line + "\n", kCsvHeader);
  std::vector<std::string> places;
  while (std::getline(csv, line)) {
    EXPECT_THAT(line, testing::MatchesRegex("[0-9]+,[0-9]+,[0-9.]+,[0-9.]+,[0-9.]+,[0-9.]+"));
    places.push_back(line.substr(0, line.find(',', line.find(',') + 1)));
  }
  EXPECT_THAT(places, testing::ElementsAre("10,0", "10,1", "20,0", "20,1"));

  const Json summary = read_json(out / "summary.json");
  ASSERT_TRUE(summary.is_object());
  expect_finite(summary, {"gaussians", "iterations", "ssim_mean", "ssim_min", "psnr_mean", "flip_mean", "flip_max",
                          "steps_per_s", "views_per_s", "optimizer_s", "host_copied_bytes", "enough_gaussians"});
  EXPECT_EQ(summary["iterations"], 20);
  ASSERT_EQ(summary["evaluations"].size(), 2U);
  EXPECT_GT(summary["evaluations"][0]["optimizer_s"], 0);
  EXPECT_EQ(summary["evaluations"][1]["iteration"], 20);
  EXPECT_EQ(summary["evaluations"][1]["optimizer_s"], summary["optimizer_s"]);
  EXPECT_GT(summary["gaussians"], 100);
  EXPECT_GT(summary["ssim_mean"], 0.3);
  EXPECT_LE(summary["ssim_min"], summary["ssim_mean"]);
  EXPECT_GE(summary["flip_max"], summary["flip_mean"]);
  EXPECT_FALSE(metrics::read_png((out / "contact_sheet.png").string()).empty());
  EXPECT_GT(summary["inserted_s"], 0);
  EXPECT_GE(summary["ready_s"], summary["inserted_s"]);
  EXPECT_GE(summary["optimized_s"], summary["ready_s"]);
}

TEST(Measure, EvalStartSaysWhenThereIsAModel) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  const Answer answer = splatbus_command({"eval", "start", "--cameras", "3", "--size", "48", "--input-cameras", "4",
                                          "--input-size", "48", "--budget", "3000", "--ready-gaussians", "100",
                                          "--timeout", "90", "--json", "--out", out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  EXPECT_EQ(answer.json().back(), summary);
  expect_finite(summary,
                {"enough_gaussians", "inserted_s", "ready_s", "optimized_s", "gaussians", "step", "host_copied_bytes"});
  EXPECT_GE(summary["gaussians"], 100);
  EXPECT_GT(summary["inserted_s"], 0);
  EXPECT_GE(summary["optimized_s"], summary["inserted_s"]);
}

TEST(Measure, EvalDynamicsTellsOnFromOff) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  // The sun is so fast that a state of the start is wrong for most of the time, and what follows it is not.
  const Answer answer =
      splatbus_command({"eval",         "dynamics", "--cameras",  "4",     "--size",    "64",    "--input-cameras", "8",
                        "--input-size", "64",       "--budget",   "12000", "--seconds", "15",    "--still-seconds", "8",
                        "--lights",     "turning",  "--sun-rate", "40",    "--json",    "--out", out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  EXPECT_EQ(answer.json().back(), summary);
  expect_finite(summary, {"still_ssim", "on_ssim", "off_ssim", "on_ssim_worst_second", "on_flip", "masked_ssim_drop",
                          "ssim_viewer", "state_delay_ms_median", "state_delay_ms_p99", "scene_kbps", "visibility_kbps",
                          "gaussians", "pictures"});
  EXPECT_GT(summary["still_ssim"], 0.85);
  EXPECT_GT(summary["on_ssim"], summary["off_ssim"].get<double>() + 0.02);
  EXPECT_GT(summary["on_ssim"], 0.8);
  EXPECT_LE(summary["on_ssim_worst_second"], summary["on_ssim"]);
  EXPECT_GT(summary["scene_kbps"], 0);
  EXPECT_GE(summary["state_delay_ms_p99"], summary["state_delay_ms_median"]);
  EXPECT_EQ(summary["turning"]["on_ssim"], summary["on_ssim"]);
  EXPECT_FALSE(metrics::read_png((out / "turning_0.png").string()).empty());
}

TEST(Measure, EvalMovingGoesRoundWithBothRigs) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  const Answer answer = splatbus_command({"eval", "moving", "--cameras", "6", "--size", "64", "--input-cameras", "8",
                                          "--input-size", "64", "--budget", "12000", "--seconds", "10", "--period", "8",
                                          "--json", "--out", out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  EXPECT_EQ(answer.json().back(), summary);
  for (const char* run : {"fixed", "rig"}) {
    SCOPED_TRACE(run);
    expect_finite(summary[run], {"ssim_server", "ssim_viewer", "flip_server", "flip_viewer", "gaussians"});
    // Drawn from anywhere else than the engine's camera, this scene has 0.5.
    EXPECT_GT(summary[run]["ssim_server"], 0.85);
    EXPECT_GT(summary[run]["ssim_viewer"], 0.8);
    EXPECT_LT(summary[run]["flip_server"], 0.2);
  }
  EXPECT_EQ(summary["ssim_server"], summary["rig"]["ssim_server"]);

  // Where the pictures were taken from: all round, at the orbit's speed, though a pose is up to a tenth of a second
  // old.
  std::ifstream csv(out / "figures.csv");
  std::string line;
  ASSERT_TRUE(std::getline(csv, line));
  std::map<std::string, std::vector<std::pair<double, double>>> angles;
  while (std::getline(csv, line)) {
    std::istringstream cells(line);
    std::string run, time, angle;
    std::getline(std::getline(std::getline(cells, run, ','), time, ','), angle, ',');
    angles[run].emplace_back(std::stod(time), std::stod(angle));
  }
  for (const char* run : {"fixed", "rig"}) {
    SCOPED_TRACE(run);
    ASSERT_GT(angles[run].size(), 10U);
    for (const auto& [time, angle] : angles[run]) {
      const double expected = angles[run].front().second + 45 * (time - angles[run].front().first);
      EXPECT_LT(std::abs(std::remainder(angle - expected, 360)), 20) << time;
    }
  }
  EXPECT_FALSE(metrics::read_png((out / "figures.png").string()).empty());
}

TEST(Measure, EvalExploreWalksOutAndBackAndJumpsToTheStart) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval", way = folder.path() / "way.txt";
  std::ofstream(way) << "2 1.6 3\n40 1.6 3\n";
  const Answer answer = splatbus_command(
      {"eval",           "explore", "--scene",         "field200", "--path",       way.string(), "--seconds", "12",
       "--back-seconds", "8",       "--speed",         "2",        "--stay",       "4",          "--size",    "64",
       "--cameras",      "4",       "--input-cameras", "8",        "--input-size", "64",         "--budget",  "12000",
       "--viewers",      "2",       "--json",          "--out",    out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  EXPECT_EQ(answer.json().back(), summary);
  expect_finite(summary,
                {"gaussians_total", "gaussians_active", "step_ms_at_30s", "step_ms_at_end", "host_mb_peak",
                 "device_mb_peak", "disk_mb", "unmodelled_share_max", "ssim_mean", "ssim_mean_second", "flip_mean",
                 "ssim_left", "ssim_return", "gaussians_before_return", "gaussians_after_return"});
  EXPECT_TRUE(summary["views_per_s_ratio"].is_null()) << "nothing was compared";
  EXPECT_EQ(summary["walk_s"], 20);
  EXPECT_EQ(summary["out_s"], 12);
  // Of those at 0, 5, 10 and 15 m of 24, the last two are just 8 m behind at the turn: a busy machine asks too late.
  EXPECT_GE(summary["stations"], 2);
  EXPECT_GT(summary["host_mb_peak"], 100);

  // Where the first viewer was, against the way at 2 m/s.
  std::ifstream csv(out / "figures.csv");
  std::string line;
  ASSERT_TRUE(std::getline(csv, line));
  EXPECT_THAT(line, testing::StartsWith("time_s,phase,x,y,z,gaussians,"));
  const std::size_t share_column =
      std::count(line.begin(), line.begin() + static_cast<long>(line.find(",unmodelled_share,")), ',') + 1;
  double share_at_start = 1;
  std::map<std::string, int> rows;
  while (std::getline(csv, line)) {
    std::istringstream cells(line);
    std::vector<std::string> row;
    for (std::string cell; std::getline(cells, cell, ',');) row.push_back(cell);
    ASSERT_GT(row.size(), 5U) << line;
    const std::string& phase = row[1];
    const auto number = [&](std::size_t column) { return std::stod(row[column]); };
    const double time = number(0);
    // Told to go, the viewer goes at once, but within a second of that and of the turns nothing is certain.
    if (std::abs(time - 12) < 1 || std::abs(time - 20) < 1) continue;
    ++rows[phase];
    const double along = time < 12 ? 2 * time : time < 20 ? 24 - 2 * (time - 12) : 0;
    EXPECT_NEAR(number(2), 2 + along, 2.5) << line;
    EXPECT_NEAR(number(3), 1.6, 1e-3) << line;
    EXPECT_NEAR(number(4), 3, 1e-3) << line;
    const std::string share = row.size() > share_column ? row[share_column] : "";
    if (time < 3 && !share.empty()) share_at_start = std::min(share_at_start, std::stod(share));
  }
  EXPECT_GT(rows["out"], 4);
  EXPECT_GT(rows["back"], 2);
  EXPECT_GT(rows["teleported"], 1);
  // Without a Gaussian the ground is missing, a half. Trained or not, it is there when the walk begins.
  EXPECT_LT(share_at_start, 0.1);
  for (const char* name : {"figures.png", "contact_sheet.png"}) {
    EXPECT_FALSE(metrics::read_png((out / name).string()).empty()) << name;
  }
}

TEST(Measure, EvalStreamGoesOverALinkThatIsCut) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  const Answer answer = splatbus_command(
      {"eval",         "stream", "--cameras",    "4",     "--size",    "64",    "--input-cameras", "8",
       "--input-size", "64",     "--budget",     "4000",  "--seconds", "6",     "--every",         "0.5",
       "--viewers",    "1,3",    "--round-trip", "40",    "--rate",    "20",    "--loss",          "1",
       "--cut",        "1",      "--link",       "relay", "--json",    "--out", out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  EXPECT_EQ(answer.json().back(), summary);
  expect_finite(summary, {"gaussians", "mbps_mean", "mbps_median", "mbps_peak", "ssim_server", "ssim_viewer",
                          "ssim_gap_worst", "join_first_s", "join_whole_s", "latency_ms", "cut_s"});
  EXPECT_EQ(summary["link"], "relay: 20 Mbit/s, 40 ms round trip, 1 % loss");
  EXPECT_GT(summary["gaussians"], 100);
  EXPECT_GT(summary["mbps_peak"], 0);
  EXPECT_LE(summary["mbps_mean"], summary["mbps_peak"]);
  EXPECT_GT(summary["ssim_server"], 0.5);
  EXPECT_GT(summary["ssim_viewer"], 0.5);
  EXPECT_GE(summary["join_first_s"], 0.06) << "a connection takes a round trip, its first words another";
  EXPECT_GE(summary["join_whole_s"], summary["join_first_s"]);
  EXPECT_GE(summary["latency_delivery_ms"], 20) << "half of a round trip";
  EXPECT_EQ(summary["cut_s"], 1);
  ASSERT_EQ(summary["stages"].size(), 2U);
  EXPECT_EQ(summary["stages"][1]["viewers"], 3);
  EXPECT_EQ(summary["stages"][1]["whole"], 2) << "those that only follow";
  for (const char* name : {"figures.csv", "bitrate.csv", "server.csv"}) EXPECT_TRUE(fs::exists(out / name)) << name;
  EXPECT_FALSE(metrics::read_png((out / "figures.png").string()).empty());
}

TEST(Measure, EvalRelightShowsSunsThatItWasNotTrainedWith) {
  const PrivateBusFolder folder;
  const fs::path out = folder.path() / "eval";
  const Answer answer = splatbus_command({"eval", "relight", "--cameras", "4", "--size", "64", "--input-cameras", "8",
                                          "--input-size", "64", "--budget", "12000", "--iterations", "60", "--timeout",
                                          "90", "--json", "--out", out.string()});
  ASSERT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  const Json summary = read_json(out / "summary.json");
  expect_finite(summary, {"ssim_own", "ssim_mean", "ssim_min", "ssim_point_lights", "gaussians", "iterations"});
  EXPECT_EQ(summary["iterations"], 60) << "not one step under another sun";
  ASSERT_EQ(summary["suns"].size(), 6U);
  EXPECT_EQ(summary["suns"][5]["turn_deg"], 180);
  EXPECT_GT(summary["ssim_own"], 0.8);
  EXPECT_GT(summary["ssim_min"], summary["ssim_own"].get<double>() - 0.1);
  EXPECT_LE(summary["ssim_min"], summary["ssim_mean"]);
  EXPECT_GT(summary["ssim_point_lights"], 0.7);
  EXPECT_FALSE(metrics::read_png((out / "contact_sheet.png").string()).empty());
}

}  // namespace
}  // namespace splatbus::cli
