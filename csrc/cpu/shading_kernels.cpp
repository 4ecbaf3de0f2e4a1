#include "core/isa.h"
