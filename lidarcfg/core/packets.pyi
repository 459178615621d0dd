from lidarcfg.geometry import Array
