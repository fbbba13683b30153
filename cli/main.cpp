#include <array>

#include "program.h"

int main(int argc, char** argv) {
  using namespace splatbus::cli;
  constexpr std::array<AddVerb, 18> kVerbs{
      add_launch_verb, add_operate_verbs, add_param_verb, add_topic_verb,  add_node_verb,   add_top_verb,
      add_trace_verb,  add_doctor_verb,   add_keys_verb,  add_export_verb, add_health_verb, add_world_verb,
      add_eval_verb,   add_demo_verb,     add_view_verb,  add_record_verb, add_play_verb,   add_reference_verbs};
  return run_program(argc, argv, kVerbs);
}
