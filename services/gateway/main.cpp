#include <spdlog/spdlog.h>

#include "bus/clock.h"
#include "bus/service.h"
#include "gateway/server.h"

namespace {

using namespace splatbus;

void run(bus::ServiceContext& service) {
  const auto options = service.parameters.read<gateway::Options>();
  gateway::PipelineView pipeline(service.bus);
  gateway::Traffic traffic;
  const std::string streamer = gateway::streamer_endpoint(options, service.bus->address());
  zmq::context_t context;
  gateway::PageLibrary pages(context, streamer, options.page_cache_bytes, traffic);
  gateway::ModelFiles models(service.bus, options.max_model_gaussians, traffic);
  gateway::Site site(options, pipeline, pages, models, traffic);
  gateway::Server server(options, streamer, site, pages, traffic);
  spdlog::info("{}, {} files of the page", server.url(), site.files());
  service.detail(server.url());
  server.run(service.stop, [&] {
    pipeline.poll(bus::now_ns());
    service.counter("connections", static_cast<double>(traffic.connections));
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
  };
  return bus::service_main(argc, argv, description, run);
}
