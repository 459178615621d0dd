from .bag import save_bag as save_bag
from .drive_dataset import DriveDataset as DriveDataset
from .drive_dataset import load_drive as load_drive
from .formats import FORMATS as FORMATS
from .formats import choose_format as choose_format
from .formats import convert as convert
from .formats import save_dataset as save_dataset
