#include "viewer/options.h"

namespace splatbus::viewer {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  p.add("endpoint", endpoint, "endpoint of a streamer; empty: one of those on the bus, and another when it leaves",
        bus::viewer_endpoint_rule(), kFixed);
  p.add("fps", fps, "most pictures per second; one is drawn when scene, model or camera have changed", {0.1, 240});
  p.add("threads", threads, "CPU rendering threads (0: one per core)", {0, 1024}, kFixed);
  p.add("key", key, "key file for a streamer on another machine; empty: SPLATBUS_KEY", kFixed);
  p.add("server_key", server_key, "public key of that streamer; empty: SPLATBUS_SERVER_KEY", kFixed);
  p.add("token", token, "token for a gateway (ws://, wss://); empty: the one in the address, or SPLATBUS_TOKEN",
        kFixed);
  p.add("ca", ca, "PEM file of the authority that signed the gateway's certificate; empty: those the system trusts",
        kFixed);
  p.add("out", out, "folder for pictures; empty: write none", kFixed);
  p.add("frames", frames, "write every n-th picture to 'out' as frame_<number>.png; 0: none", {0, 1e9});
  p.add("probe", probe, "compare with the engine's own pictures when they arrive; write probe_<id>_viewer.png to 'out'",
        kFixed);
  p.add("probe_alpha", probe_alpha, "with 'probe': write probe_<id>_alpha.png too, black where nothing is modelled",
        kFixed);
  p.add("probe_period_s", probe_period_s,
        "with 'probe': time between requests for the engine's picture of this camera; 0: only what others ask for, s",
        {0, 1e6});
  p.add("window", window, "open a window, steered with mouse and keys, drawn at the display's rate", kFixed);
  p.add("opengl", opengl, "draw with OpenGL even without a window", kFixed);
  p.add("draw", draw,
        "how OpenGL draws: as quads, as tiles in compute shaders, or by whichever is the faster on this device",
        {{"auto", gl::Draw::Auto}, {"quads", gl::Draw::Quads}, {"tiles", gl::Draw::Tiles}}, kFixed);
  p.add("max_gaussians", max_gaussians,
        "most Gaussians held; of a larger world, those that add most to this viewer's picture",
        {1024, static_cast<double>(stream::kMaxGaussians)}, kFixed);
  p.add("max_kbps", max_kbps, "rate below which the streamer is asked to stay, kbit/s; 0: the streamer's own", {0, 1e7},
        kFixed);
  p.add("record_file", record_file, "file for the camera's way, to be replayed with path=recorded; empty: none",
        kFixed);
  p.add("packet_log", packet_log, "file for every packet from the streamer; empty: none", kFixed);
  path.bind(p);
}

}  // namespace splatbus::viewer
