#pragma once

#include <map>
#include <memory>
#include <utility>

#include "gl/objects.h"
#include "sim/depth_versions.h"
#include "sim/gpu_scene.h"
#include "sim/lit_shading.h"
#include "sim/renderer.h"
#include "sim/shaders.h"
#include "sim/sky.h"
#include "sim/targets.h"

namespace splatbus::sim {

struct Renderer::Impl {
  Impl(std::shared_ptr<GlContext> gl_context, Scene the_scene, const RendererOptions& the_options)
      : context(std::move(gl_context)),
        scene(std::move(the_scene)),
        options(the_options),
        gpu(scene, options.anisotropy, options.cull),
        targets(options.supersample, options.samples),
        lighting({options.shadow_map_size, options.source_map_size, options.shadow_softness_m}, scene),
        bounds(scene.bounds(false)) {}

  std::shared_ptr<GlContext> context;
  Scene scene;
  RendererOptions options;
  GpuScene gpu;
  TargetCache targets;
  LitShading lighting;
  Sky sky;
  Bounds bounds;
  std::map<ShaderVariant, GlProgram> programs;
  std::map<std::pair<bool, bool>, GlProgram> resolve_programs;
  GlVertexArray no_vertices = make_vertex_array();
  Instant instant;
  std::uint64_t scene_version = 0;
  DepthVersions depth_versions;
  Pictures pictures;

  GLuint program(const ShaderVariant& variant) {
    GlProgram& made = programs[variant];
    if (!made) made = build_program(variant);
    return made.get();
  }

  void shade(const LightCamera& view, bool lit, bool albedo, Readback& readback);
  void geometry(const LightCamera& view, std::uint32_t buffers, Readback& readback);
};

}  // namespace splatbus::sim
