#include <fmt/format.h>

#include <map>
#include <stdexcept>

#include "eval_options.h"
#include "light_followers.h"
#include "stream_evaluation.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kMostViewers = 1000;

struct StreamVerbOptions : CommonOptions {
  StreamOptions stream;
  double loss_percent = 0;
  bool curve = false;
};

struct FollowersVerbOptions {
  std::string endpoint;
  std::size_t count = 1;
};

int evaluate_stream(StreamVerbOptions options) {
  StreamRunOptions& run = options.stream.run;
  options.default_launch = run.walk ? "eval_explore.yaml" : "demo.yaml";
  options.complete(run.setup);
  run.shape.loss = options.loss_percent / 100;
  if (options.curve) options.stream.curve_mbps = {1, 2, 5, 10, 20};
  if (options.curve && run.shape.mbps > 0) throw std::runtime_error("--curve sets the rates: omit --rate");
  if (run.walk && run.still) throw std::runtime_error("--still applies to the demo's scene: omit it with --walk");
  return evaluate(options, "figures.csv, bitrate.csv, server.csv, figures.png, summary.json",
                  [&](const StopSignals& signals, const auto& show) {
                    return run_stream_evaluation(options.stream, signals, show);
                  });
}

int follow(const FollowersVerbOptions& options) {
  const StopSignals signals;
  run_light_followers(options.endpoint, options.count, signals);
  return 0;
}

void add_stream_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<StreamVerbOptions>();
  CLI::App* verb = eval.add_subcommand("stream", "Bit rate and quality of a viewer behind a network link, over time");
  StreamRunOptions& run = options->stream.run;
  add_setup_options(*verb, *options, run.setup);
  verb->get_option("--seed")->description("random seed of the scene and the trainer");
  verb->get_option("--launch")->description("launch file (default: launch/demo.yaml, with --walk eval_explore.yaml)");
  verb->add_option("--seconds", run.seconds, "duration from the first picture on, for each count of --viewers, s")
      ->check(CLI::Range(5.0, 86400.0));
  verb->add_option("--every", run.every_s, "time between compared pictures, s")->check(CLI::Range(0.1, 60.0));
  verb->add_flag("--walk", run.walk,
                 "use the walk of 'eval explore' (default: the demo's scene and an orbiting viewer)");
  verb->add_flag("--still", run.still, "keep sun and objects still");
  verb->add_option("--speed", run.speed_m_s, "speed of the walk, m/s")->check(CLI::Range(0.01, 100.0));
  verb->add_option("--period", run.period_s, "time of one orbit, s")->check(CLI::Range(0.1, 86400.0));
  verb->add_option("--rate", run.shape.mbps, "rate of the link each way, Mbit/s; 0: no limit")
      ->check(CLI::Range(0.0, 1e5));
  verb->add_option("--round-trip", run.shape.round_trip_ms, "round trip of the link, ms")->check(CLI::Range(0.0, 1e4));
  verb->add_option("--loss", options->loss_percent, "packet loss of the link, percent")->check(CLI::Range(0.0, 50.0));
  verb->add_option("--cut", run.cut_s, "outage of the link half-way, s; 0: none")->check(CLI::Range(0.0, 3600.0));
  verb->add_option("--link", run.link,
                   "what shapes the link: netem in a network namespace, a built-in relay, or auto (netem if permitted)")
      ->transform(CLI::CheckedTransformer(std::map<std::string, LinkKind>{
          {"auto", LinkKind::Auto}, {"netem", LinkKind::Netem}, {"relay", LinkKind::Relay}}))
      ->default_str("auto");
  verb->add_option(
          "--viewer-kbps", run.viewer_kbps,
          "the streamer's viewer_kbps; 0: estimate (default: estimate over a link with a rate, else the launch "
          "file's)")
      ->check(CLI::Range(0.0, 1e7));
  verb->add_flag("--curve", options->curve, "one run each over links of 1, 2, 5, 10 and 20 Mbit/s");
  verb->add_option("--viewers", run.viewers,
                   "viewer counts to run one after the other, such as 1,10,100; all but the first draw nothing")
      ->delimiter(',')
      ->check(CLI::Range(std::size_t{1}, kMostViewers));
  verb->callback([options, &action] { action = [options] { return evaluate_stream(*options); }; });
}

void add_followers_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<FollowersVerbOptions>();
  CLI::App* verb = eval.add_subcommand("followers", "Viewers that draw nothing, for 'eval stream --viewers'");
  verb->group("");  // not for people: the help leaves it out
  verb->add_option("--connect", options->endpoint, "the streamer's endpoint")->required();
  verb->add_option("--count", options->count, "how many")->check(CLI::Range(std::size_t{1}, kMostViewers));
  verb->callback([options, &action] { action = [options] { return follow(*options); }; });
}

}  // namespace

void add_stream_verbs(CLI::App& eval, Action& action) {
  add_stream_verb(eval, action);
  add_followers_verb(eval, action);
}

}  // namespace splatbus::cli
