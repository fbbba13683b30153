#include <spdlog/spdlog.h>

#include "bus/clock.h"
#include "bus/service.h"
#include "gateway/foxglove/service.h"
#include "gateway/server.h"

namespace {

using namespace splatbus;

void run(bus::ServiceContext& service) {
  const auto options = service.parameters.read<gateway::Options>();
  gateway::PipelineView pipeline(service.bus);
  gateway::Traffic traffic;
  const std::string streamer = gateway::streamer_endpoint(options, service.bus->address());
  gateway::Streamers streamers =
      options.endpoint.empty() ? gateway::Streamers(service.bus, streamer) : gateway::Streamers(streamer);
  zmq::context_t context;
  gateway::PageLibrary pages(context, streamer, options.page_cache_bytes, traffic);
  gateway::ModelFiles models(service.bus, options.max_model_gaussians, traffic, options.mip);
  gateway::Site site(options, pipeline, pages, models, traffic);
  gateway::foxglove::Service foxglove(service.bus, options);
  gateway::Server server(options, streamers, site, pages, models, foxglove.hub(), traffic);
  spdlog::info("{}, {} files of the page", server.url(), site.files());
  service.detail(server.url());
  service.ready();
  server.run(service.stop, [&] {
    pipeline.poll(bus::now_ns());
    service.counter("connections", static_cast<double>(traffic.connections));
    service.counter("moves", static_cast<double>(traffic.moves));
    service.counter("viewers", static_cast<double>(traffic.viewers));
    service.counter("bytes_to", static_cast<double>(traffic.bytes_to));
  });
}

}  // namespace

int main(int argc, char** argv) {
  const bus::ServiceDescription description{
      .kind = "gateway",
      .summary = "Serves browsers over HTTP: the page, the stream over WebSocket, and metrics",
      .parameters = bus::Parameters::declare<gateway::Options>(),
      .check = [](const bus::Parameters& parameters) { gateway::check(parameters.read<gateway::Options>()); },
      .opens_ports = true,
  };
  return bus::service_main(argc, argv, description, run);
}
