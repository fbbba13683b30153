// The program splatbus with the verb demo alone, which a newcomer's first command builds: a quarter of what all verbs
// take.
#include <array>

#include "program.h"

int main(int argc, char** argv) {
  using namespace splatbus::cli;
  constexpr std::array<AddVerb, 1> kVerbs{add_demo_verb};
  return run_program(argc, argv, kVerbs);
}
