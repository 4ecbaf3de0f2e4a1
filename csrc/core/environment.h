// What is thrown where a variable of the environment holds what it cannot.
#pragma once

#include <stdexcept>

namespace mipbake {

struct EnvironmentFault : std::invalid_argument {
    using std::invalid_argument::invalid_argument;
};

}  // namespace mipbake
