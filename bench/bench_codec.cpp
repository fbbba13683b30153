// What the codecs of pages make of models: bytes by attribute, quality of the pictures, time on one core.
#include <fmt/format.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <map>
#include <numeric>
#include <string>

#include "bench/codec_scene.h"
#include "stream/model_quantizer.h"
#include "stream/page_codec_parts.h"
#include "stream/page_precision.h"

namespace splatbus::bench {

namespace {

using stream::PageCodec;

struct Options {
  std::vector<std::string> models;
  std::vector<int> degrees{0, 3};
  std::vector<float> coarseness{2.5F}, steps{0};
  float mean_fraction = 0.25F, target_db = 0;
  int repetitions = 5;
  std::size_t page_gaussians = kPageLanes;
  bool ids = false, draco = true;
};

double thread_ms() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) * 1e3 + static_cast<double>(time.tv_nsec) / 1e6;
}

/// A model as integers, page by page.
struct Quantized {
  stream::StreamLayout layout;
  stream::QuantizedGaussians all;
  std::vector<std::size_t> page_ends;

  Quantized(const CodecScene& scene, float mean_fraction, const std::vector<float>& steps)
      : page_ends(scene.page_ends) {
    stream::ModelQuantizer quantizer(Device::Cpu);
    const GaussiansView model = scene.model.view();
    layout = layout_with(stream::StreamLayout(scene.model.layout(), mean_fraction * quantizer.choose_mean_step(model)),
                         steps);
    std::vector<std::uint8_t> usable;
    (void)quantizer.ids(model);
    quantizer.quantize(model, layout, nullptr, {});
    quantizer.commit(all, usable);
  }

  [[nodiscard]] std::vector<stream::QuantizedGaussians> pages(float coarseness) const {
    const stream::Precision precision(layout, coarseness);
    std::vector<stream::QuantizedGaussians> out;
    std::size_t begin = 0;
    for (const std::size_t end : page_ends) {
      std::vector<std::uint32_t> columns(end - begin);
      std::iota(columns.begin(), columns.end(), static_cast<std::uint32_t>(begin));
      precision.round(out.emplace_back(all.gather(columns)));
      begin = end;
    }
    return out;
  }
};

double psnr_db(const Pictures& pictures, const Quantized& model, const std::vector<stream::QuantizedGaussians>& pages) {
  stream::QuantizedGaussians joined(model.layout);
  for (const stream::QuantizedGaussians& page : pages) joined.append(page);
  return pictures.psnr_db(joined, model.layout);
}

void report(const Options& options, const Quantized& model, const std::vector<stream::QuantizedGaussians>& pages,
            PageCodec codec, const std::string& title) {
  const stream::PageOptions page_options{.ids = options.ids, .keep_order = false, .origin = {}};
  const auto count = static_cast<double>(model.all.count());
  // Page by page, the best of each: of a machine that others use, too, that says most.
  std::vector<double> encode(pages.size(), 1e300), decode(pages.size(), 1e300);
  double bytes = 0;
  for (int k = 0; k < options.repetitions; ++k) {
    bytes = 0;
    for (std::size_t p = 0; p < pages.size(); ++p) {
      const double begin = thread_ms();
      const stream::PageBlob blob = stream::encode_page(pages[p], model.layout, codec, page_options);
      const double middle = thread_ms();
      const auto read = stream::decode_page(blob.bytes, model.layout, codec, pages[p].count());
      const double end = thread_ms();
      encode[p] = std::min(encode[p], middle - begin);
      decode[p] = std::min(decode[p], end - middle);
      bytes += static_cast<double>(blob.bytes.size());
    }
  }
  const double encode_ms = std::accumulate(encode.begin(), encode.end(), 0.0);
  const double decode_ms = std::accumulate(decode.begin(), decode.end(), 0.0);
  fmt::print("{} {:>6} {:6.2f} B/Gaussian, encode {:5.1f} ms, decode {:5.1f} ms a 100K", title,
             codec == PageCodec::Draco ? "draco" : "planes", bytes / count, encode_ms * 1e5 / count,
             decode_ms * 1e5 / count);
  if (codec == PageCodec::Planes) {
    std::map<std::string, double> parts;
    for (const auto& page : pages) {
      std::vector<stream::PartBytes> account;
      (void)stream::encode_planes(page, model.layout, page_options, &account);
      for (const stream::PartBytes& part : account) parts[part.name] += part.bytes;
    }
    for (const auto& [name, part] : parts) fmt::print(", {} {:.2f}", name, part / count);
  }
  fmt::print("\n");
}

void run(const Options& options, const std::string& path, int degree) {
  const CodecScene scene = load_codec_scene(path, degree, options.page_gaussians);
  const Quantized model(scene, options.mean_fraction, options.steps);
  const Pictures pictures(scene);
  const ParameterLayout& layout = scene.model.layout();
  const std::string name =
      fmt::format("{} {}", scene.name,
                  layout.appearance == Appearance::Transfer ? "transfer" : fmt::format("SH{}", layout.sh_degree));
  fmt::print("{}: {} Gaussians in {} pages, unrounded {:.2f} dB\n", name, scene.model.count(), scene.page_ends.size(),
             pictures.psnr_db(model.all, model.layout));
  std::vector<float> coarseness = options.coarseness;
  if (options.target_db > 0) {
    float fine = -4, coarse = 8;
    for (int k = 0; k < 7; ++k) {
      const float middle = 0.5F * (fine + coarse);
      (psnr_db(pictures, model, model.pages(middle)) >= options.target_db ? fine : coarse) = middle;
    }
    coarseness = {fine};
  }
  for (const float c : coarseness) {
    const auto pages = model.pages(c);
    const std::string title = fmt::format("{} coarseness {:.2f}, {:.2f} dB:", name, c, psnr_db(pictures, model, pages));
    if (options.draco) report(options, model, pages, PageCodec::Draco, title);
    report(options, model, pages, PageCodec::Planes, title);
  }
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("Codecs of pages: bytes, quality and time");
  app.add_option("models", options.models, "PLY files and world folders")->required();
  app.add_option("--degree", options.degrees, "SH degrees that a PLY is cut to");
  app.add_option("--coarseness", options.coarseness, "of stream::Precision");
  app.add_option("--target-db", options.target_db, "search the coarseness that still gives this");
  app.add_option("--mean-fraction", options.mean_fraction, "of the step that ModelQuantizer chooses for means");
  app.add_option("--steps", options.steps, "of the layout's attributes in their order; 0: its own");
  app.add_option("--page-gaussians", options.page_gaussians, "that a page cut from a PLY has");
  app.add_option("--repetitions", options.repetitions, "the best of so many counts, page by page");
  app.add_flag("!--planes-only", options.draco, "without Draco");
  app.add_flag("--ids", options.ids, "ids travel, too");
  CLI11_PARSE(app, argc, argv);
  for (const std::string& path : options.models) {
    const bool folder = std::filesystem::is_directory(path);
    for (const int degree : folder ? std::vector<int>{-1} : options.degrees)
      splatbus::bench::run(options, path, degree);
  }
  return 0;
}
