#include "capture-bridge/cuda/cuda_sampler.h"

#include <algorithm>
#include <cassert>
#include <vector>

#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/warm_up.h"
#include "capture-bridge/pixel_views.h"
#include "capture-bridge/surface_math.h"
#include "device/pinned.h"
#include "device/stream.h"

namespace splatbus::capture_bridge {

namespace {

using cuda::Buffer;

/// Owner of SampleArrays.
struct SampleMemory {
  Buffer<float> position, normal, albedo, color, footprint_m, spacing_m, cosine;
  Buffer<std::uint32_t> object_id, camera;

  cuda::SampleArrays resize(std::size_t count) {
    for (auto* vectors : {&position, &normal, &albedo, &color}) vectors->resize(3 * count);
    for (auto* scalars : {&footprint_m, &spacing_m, &cosine}) scalars->resize(count);
    for (auto* ids : {&object_id, &camera}) ids->resize(count);
    return {static_cast<std::uint32_t>(count),
            position.data(),
            normal.data(),
            albedo.data(),
            color.data(),
            footprint_m.data(),
            spacing_m.data(),
            cosine.data(),
            object_id.data(),
            camera.data()};
  }
};

/// Owner of what survives culling.
struct SurvivorMemory {
  Buffer<std::uint32_t> pixel;
  Buffer<float> position, area_m2;

  cuda::Survivors resize(std::size_t count) {
    pixel.resize(count);
    position.resize(3 * count);
    area_m2.resize(count);
    return {static_cast<std::uint32_t>(count), pixel.data(), position.data(), area_m2.data()};
  }
};

/// Owner of a round's pixels.
struct PixelMemory {
  Buffer<PixelView> views;
  Buffer<MovedObject> moved;
  Buffer<float> depth_m, cosine;
  Buffer<std::uint32_t> object_id;
  Buffer<Texel> texels;
  Buffer<SurfaceRank> ranks;

  void resize(std::size_t pixels) {
    depth_m.resize(pixels);
    cosine.resize(pixels);
    object_id.resize(pixels);
    texels.resize(pixels);
    ranks.resize(pixels);
  }

  /// Sends the tables to the device and makes room for the pixels.
  cuda::RoundPixels upload(PixelViews tables, cudaStream_t stream) {
    resize(tables.pixels);
    moved.upload(tables.moved.data(), tables.moved.size(), stream);
    for (PixelView& view : tables.views) view.moved = moved.data() + (view.moved - tables.moved.data());
    views.upload(tables.views.data(), tables.views.size(), stream);
    const auto count = static_cast<std::uint32_t>(tables.views.size());
    return {.views = views.data(),
            .view_count = count,
            .view_pixels = static_cast<std::uint32_t>(tables.pixels) / count,
            .movement = tables.movement(),
            .depth_m = depth_m.data(),
            .cosine = cosine.data(),
            .object_id = object_id.data(),
            .texels = texels.data(),
            .ranks = ranks.data()};
  }
};

/// What comes back to the host, in pinned memory.
struct Answers {
  cuda::RoundTally tally;
  std::uint32_t kept;
  float low_m, high_m;
};

class CudaSampler final : public Sampler {
 public:
  explicit CudaSampler(const RoundSizes& expected) : answers_(1), tally_(1), count_(1) {
    linear_.upload(&linear_table(), 1, stream_.get());
    reserve(expected);
    stream_.wait();
  }

  RoundSamples sample(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) override {
    RoundSamples round{.memory = Device::Cuda};
    if (views.empty()) return round;
    assert(std::all_of(views.begin(), views.end(), [&](const InputView* view) {
      return view->memory == Device::Cuda && view->camera.width == views.front()->camera.width &&
             view->camera.height == views.front()->camera.height;
    }));
    cudaStream_t stream = stream_.get();
    const cuda::RoundPixels pixels = pixels_.upload(pixel_views(views, round_objects), stream);
    cull(pixels, options, round);
    const std::size_t survived = settle_counts(answers_[0].tally.of_rank, options, round);
    const cuda::Survivors survivors = survivors_.resize(survived);
    cuda::launch_survivors(pixels, round.cameras_per_surface, survivors, thinning_.scratch, count_.data(), stream);
    const std::size_t kept = thin(survivors, options.budget);
    round.thinned = survived - kept;
    const bool thinned = kept < survived;
    const cuda::SampleArrays samples = samples_.resize(kept);
    cuda::launch_samples(pixels, survivors, (thinned ? thinning_.kept : thinning_.order).data(),
                         spacing_growth(survived, kept), linear_.data(), samples, stream);
    nodes_.resize(2 * std::size_t{NeighbourTree::leaves_for(samples.count)});
    cuda::launch_spacing(samples, nodes_.data(), stream);
    measure_heights(samples, round);
    describe(pixels, samples, round);
    return round;
  }

 private:
  /// Makes room for rounds of the sizes that are expected, within reason.
  void reserve(const RoundSizes& expected) {
    constexpr std::size_t kMostReserved = std::size_t{1} << 24;
    const std::size_t pixels = std::min(expected.views * expected.pixels, kMostReserved);
    const std::size_t samples = std::min(expected.samples, pixels);
    pixels_.resize(pixels);
    static_cast<void>(survivors_.resize(pixels));
    thinning_.resize(pixels);
    static_cast<void>(samples_.resize(samples));
    for (auto* heights : {&heights_, &heights_sorted_}) heights->resize(samples);
    nodes_.resize(2 * std::size_t{NeighbourTree::leaves_for(static_cast<std::uint32_t>(samples))});
  }

  /// Surfaces, ranks, and how many samples there are of each.
  void cull(const cuda::RoundPixels& pixels, const SamplingOptions& options, RoundCounts& counts) {
    cudaStream_t stream = stream_.get();
    tally_.clear(stream);
    cuda::launch_surface(pixels, options.surface.min_cosine, tally_.data(), stream);
    cuda::launch_ranks(pixels, options.culling, tally_.data(), stream);
    tally_.download(&answers_[0].tally, 1, stream);
    stream_.wait();
    for (std::uint32_t v = 0; v < pixels.view_count; ++v) {
      const auto& faults = answers_[0].tally.faults[v];
      const auto of = [&faults](PixelFault fault) { return std::size_t{faults[static_cast<std::size_t>(fault)]}; };
      counts.dropped.push_back({.not_finite = of(PixelFault::NotFinite),
                                .bad_normal = of(PixelFault::BadNormal),
                                .off_ray = of(PixelFault::OffRay)});
    }
  }

  /// How many of the survivors stay: those of thinning_.order when all of them do, else those of thinning_.kept.
  std::size_t thin(const cuda::Survivors& survivors, std::size_t budget) {
    if (survivors.count == 0 || budget == 0) return 0;
    cudaStream_t stream = stream_.get();
    thinning_.resize(survivors.count);
    cuda::launch_morton_order(survivors, thinning_, stream);
    if (survivors.count <= budget) return survivors.count;
    cuda::launch_thinning(survivors, static_cast<std::uint32_t>(budget), thinning_, count_.data(), stream);
    count_.download(&answers_[0].kept, 1, stream);
    stream_.wait();
    return answers_[0].kept;
  }

  /// Waits for the round.
  void measure_heights(const cuda::SampleArrays& samples, RoundSamples& round) {
    cudaStream_t stream = stream_.get();
    if (samples.count > 0) {
      for (auto* heights : {&heights_, &heights_sorted_}) heights->resize(samples.count);
      cuda::launch_heights(samples, heights_.data(), heights_sorted_.data(), thinning_.scratch, stream);
      const HeightRanks ranks = height_ranks(samples.count);
      const auto read = [&](std::size_t rank, float* height) {
        device::check(
            cudaMemcpyAsync(height, heights_sorted_.data() + rank, sizeof(float), cudaMemcpyDeviceToHost, stream),
            "reading heights");
      };
      read(ranks.low, &answers_[0].low_m);
      read(ranks.high, &answers_[0].high_m);
    }
    stream_.wait();
    if (samples.count > 0) round.heights = {.low_m = answers_[0].low_m, .high_m = answers_[0].high_m};
  }

  static void describe(const cuda::RoundPixels& pixels, const cuda::SampleArrays& samples, RoundSamples& round) {
    round.size = samples.count;
    round.position = samples.position;
    round.normal = samples.normal;
    round.albedo = samples.albedo;
    round.color = samples.color;
    round.footprint_m = samples.footprint_m;
    round.spacing_m = samples.spacing_m;
    round.cosine = samples.cosine;
    round.object_id = samples.object_id;
    round.camera = samples.camera;
    round.depth_m = pixels.depth_m;
  }

  device::Stream stream_;
  PixelMemory pixels_;
  SurvivorMemory survivors_;
  cuda::ThinningMemory thinning_;
  SampleMemory samples_;
  Buffer<Box> nodes_;
  Buffer<float> heights_, heights_sorted_;
  Buffer<LinearTable> linear_;
  device::Pinned<Answers> answers_;
  Buffer<cuda::RoundTally> tally_;
  Buffer<std::uint32_t> count_;
};

}  // namespace

std::unique_ptr<Sampler> make_cuda_sampler(const RoundSizes& expected) {
  auto sampler = std::make_unique<CudaSampler>(expected);
  cuda::warm_up(*sampler, expected);
  return sampler;
}

}  // namespace splatbus::capture_bridge
