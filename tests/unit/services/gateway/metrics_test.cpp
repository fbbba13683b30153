// Figures, as Prometheus and people read them.
#include "gateway/metrics.h"

#include <map>
#include <regex>
#include <set>
#include <sstream>

#include "gateway_fixture.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::gateway_test {
namespace {

using testing::HasSubstr;
using testing::Not;

class Figures : public bus_test::BusTest {
 protected:
  Figures() : view_(connect("gateway")), publisher_(connect("streamer")) {}

  void beat(const std::string& source, const std::string& kind) {
    publisher_.publish(topics::kHeartbeat, {.latch_key = source}, [&](auto& builder, auto header) {
      return wire::CreateHeartbeatDirect(builder, header, kind.c_str(), 7, wire::ServiceState::Running, "in words");
    });
  }
  void publish_stats() {
    publisher_.publish(topics::kStreamStats, [](auto& builder, auto header) {
      const std::vector<flatbuffers::Offset<wire::PacketBytes>> types{
          wire::CreatePacketBytesDirect(builder, "TensorDelta", 123456, 10, 17)};
      return wire::CreateStreamStatsDirect(builder, header, 1, 2, 4, 3, 4000, 5000, 123456, 10, 1, 0.5, 0.25, 2, 6, 7,
                                           9, 8, &types);
    });
    publisher_.publish(topics::kTrainerStats, [](auto& builder, auto header) {
      wire::TrainerStatsBuilder stats(builder);
      stats.add_header(header);
      stats.add_step(99);
      stats.add_active(11);
      stats.add_frozen(22);
      stats.add_disk_bytes(33);
      return stats.Finish();
    });
    publisher_.publish(topics::kViewerQuality, [](auto& builder, auto header) {
      return wire::CreateViewerQualityDirect(builder, header, "viewer", 1, 30, 0.9375F, 0.1F, 1, 1);
    });
  }
  /// Until all of it has come.
  void gather() {
    ASSERT_TRUE(bus_test::eventually([&] {
      beat("streamer", "streamer");
      publish_stats();
      view_.poll(bus::now_ns());
      const std::int64_t now = bus::now_ns();
      return view_.stream(now) && view_.trainer(now) && view_.quality(now) && view_.ill_because(now).empty();
    }));
  }
  [[nodiscard]] std::string metrics() const { return gateway::metrics_text(view_, traffic_, bus::now_ns()); }

  gateway::PipelineView view_;
  gateway::Traffic traffic_;
  gateway::BenchLog bench_;
  bus::Publisher publisher_;
};

TEST_F(Figures, AreThoseOfTheBus) {
  gather();
  traffic_.bytes_to = 77;
  traffic_.refuse(gateway::Refusal::Origin);
  const std::string text = metrics();
  for (const char* line :
       {"splatbus_up{service=\"streamer\",source=\"streamer\"} 1\n", "splatbus_stream_viewers 3\n",
        "splatbus_stream_gaussians 4000\n", "splatbus_stream_bytes_total{body=\"TensorDelta\"} 123456\n",
        "# TYPE splatbus_stream_bytes_total counter\n", "splatbus_stream_ssim 0.9375\n",
        "splatbus_trainer_steps_total 99\n", "splatbus_trainer_gaussians{state=\"frozen\"} 22\n",
        "splatbus_trainer_memory_bytes{memory=\"disk\"} 33\n",
        "splatbus_gateway_bytes_total{direction=\"to_browser\"} 77\n",
        "splatbus_gateway_refused_total{reason=\"origin\"} 1\n"}) {
    EXPECT_THAT(text, HasSubstr(line));
  }
  const auto status = gateway::status_json(view_, traffic_, bench_, bus::now_ns());
  EXPECT_EQ(status["healthy"], true);
  EXPECT_EQ(status["stream"]["by_type"]["TensorDelta"]["packets"], 17);
  EXPECT_EQ(status["trainer"]["frozen"], 22);
  bool found = false;
  for (const auto& service : status["services"]) {
    if (service["source"] != "streamer") continue;
    found = true;
    EXPECT_EQ(service["detail"], "in words");
    EXPECT_EQ(service["pid"], 7);
    EXPECT_LT(service["heartbeat_age_s"], 10);
  }
  EXPECT_TRUE(found);
}

TEST_F(Figures, OfAComparisonAreGoneOnceNobodyCompares) {
  gather();
  const std::int64_t now_ns = bus::now_ns();
  EXPECT_THAT(gateway::metrics_text(view_, traffic_, now_ns), HasSubstr("\nsplatbus_stream_ssim 0.9375\n"));
  const std::int64_t later_ns = now_ns + 11'000'000'000;
  EXPECT_THAT(gateway::metrics_text(view_, traffic_, later_ns), Not(HasSubstr("splatbus_stream_ssim")));
  EXPECT_THAT(gateway::metrics_text(view_, traffic_, later_ns), Not(HasSubstr("splatbus_stream_psnr_db")));
  EXPECT_FALSE(gateway::status_json(view_, traffic_, bench_, later_ns).contains("quality"));
}

// What promtool's "check metrics" asks for, and the format itself.
TEST_F(Figures, AreNamedAsPrometheusWantsThem) {
  gather();
  std::istringstream lines(metrics());
  std::map<std::string, std::string> types;
  std::set<std::string> helped, series;
  const std::regex sample(R"re(^([a-z_]+)(\{([a-z_]+="[^"]*",?)*\})? [-+0-9.e]+(Inf|NaN)?$)re"),
      name("splatbus(_[a-z0-9]+)+");
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string hash, what, metric, rest;
    words >> hash >> what >> metric;
    std::getline(words, rest);
    std::smatch match;
    if (hash == "#" && what == "HELP") {
      EXPECT_TRUE(helped.insert(metric).second) << metric << " twice";
      EXPECT_GT(rest.size(), 1U) << metric;
    } else if (hash == "#" && what == "TYPE") {
      EXPECT_TRUE(types.emplace(metric, rest).second) << metric << " twice";
      EXPECT_TRUE(std::regex_match(metric, name)) << metric;
      EXPECT_EQ(rest == " counter", metric.ends_with("_total")) << metric << rest;
      for (const char* part : {"_ms", "_milliseconds", "_kbps", "_mbps", "_mb", "_count", "_gauge", "_counter"}) {
        EXPECT_FALSE(metric.ends_with(part)) << metric << ": base units, and no types in names";
      }
    } else {
      ASSERT_TRUE(std::regex_match(line, match, sample)) << line;
      EXPECT_TRUE(types.contains(match[1]) && helped.contains(match[1])) << line;
      EXPECT_TRUE(series.insert(line.substr(0, line.rfind(' '))).second) << line << " twice";
    }
  }
  EXPECT_GT(types.size(), 30U);
}

TEST_F(Figures, EveryMetricOfTheDashboardExists) {
  gather();
  const std::string text = metrics();
  std::ifstream file(std::string(SPLATBUS_SOURCE_DIR) + "/launch/grafana-dashboard.json");
  const auto dashboard = nlohmann::json::parse(file);
  std::set<std::string> named;
  for (const auto& panel : dashboard.at("panels")) {
    for (const auto& target : panel.at("targets")) {
      const std::string expression = target.at("expr");
      const std::regex metric("splatbus_[a-z_]+");
      for (std::sregex_iterator at(expression.begin(), expression.end(), metric), end; at != end; ++at) {
        named.insert(at->str());
      }
    }
  }
  EXPECT_GT(named.size(), 15U);
  for (const std::string& name : named) EXPECT_THAT(text, HasSubstr("\n# TYPE " + name + " ")) << name;
}

TEST_F(Figures, LabelsAreBoundedWhateverIsPublished) {
  ASSERT_TRUE(bus_test::eventually([&] {
    publisher_.publish(topics::kLiveness, [&](auto& builder, auto header) {
      std::vector<flatbuffers::Offset<wire::Node>> nodes;
      for (int i = 0; i < 200; ++i) {
        const std::string text = "\"}\n" + std::to_string(i) + std::string(1000, 'x');
        nodes.push_back(wire::CreateNodeDirect(builder, text.c_str(), text.c_str(), 1, 1));
      }
      return wire::CreateLivenessDirect(builder, header, &nodes);
    });
    view_.poll(bus::now_ns());
    return view_.services(bus::now_ns()).size() > 2;
  }));
  EXPECT_EQ(view_.services(bus::now_ns()).size(), 64U);
  std::istringstream lines(metrics());
  int ups = 0;
  for (std::string line; std::getline(lines, line);) {
    EXPECT_TRUE(line.starts_with("# ") || line.starts_with("splatbus_")) << line;
    EXPECT_LT(line.size(), 300U);
    ups += line.starts_with("splatbus_up{") ? 1 : 0;
  }
  EXPECT_EQ(ups, 64);
}

}  // namespace
}  // namespace splatbus::gateway_test
